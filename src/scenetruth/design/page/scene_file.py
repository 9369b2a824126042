"""The scene file of a rig, as a page shows it and hands it over."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scenetruth.design.optimise.answer.preview import PREVIEW, preview_of
from scenetruth.design.optimise.result import Design, Rig

__all__ = ["SceneFile", "plain_yaml", "preview_file_of", "scene_file_of"]


@dataclass(frozen=True)
class SceneFile:
    """A scene file that is part of a page.

    Parameters
    ----------
    name
        What it is called when it is saved.
    text
        What it holds, in YAML.
    """

    name: str
    text: str

    @property
    def address(self) -> str:
        """The file as an address of its own, so that it can be saved from the page."""
        return "data:application/yaml;base64," + base64.b64encode(self.text.encode("utf-8")).decode("ascii")

    @property
    def commands(self) -> tuple[tuple[str, str], ...]:
        """What to do with it: words and the command."""
        stem = self.name.removesuffix(".yaml")
        return (
            ("Simulate it, estimate and score", shlex.join(["scenetruth", "run", self.name, "-o", f"outputs/{stem}"])),
            ("What takes how much of its precision", shlex.join(["scenetruth", "design", "budget", self.name])),
        )


def scene_file_of(rig: Rig, name: str) -> SceneFile:
    """Return the scene file of a rig.

    Parameters
    ----------
    rig
        The rig.
    name
        What the file is called.
    """
    return SceneFile(name, plain_yaml(rig.scene))


def preview_file_of(design: Design) -> SceneFile:
    """Return the file of a scene that shows a part of what the recommended rig sees.

    Parameters
    ----------
    design
        The design.
    """
    return SceneFile(PREVIEW, plain_yaml(preview_of(design).plain))


def plain_yaml(plain: Mapping[str, Any]) -> str:
    """Return plain values as YAML, in their order, short lists on one line."""
    import yaml

    text: str = yaml.dump(dict(plain), Dumper=_dumper(), sort_keys=False, allow_unicode=True, width=100)
    return text


def _dumper() -> Any:
    """Return what writes short lists of numbers on one line, as people write scene files."""
    import yaml

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

        def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> Any:
            plain = all(not isinstance(item, list | tuple | dict) for item in sequence)
            return super().represent_sequence(tag, sequence, flow_style=plain)

    Dumper.add_representer(tuple, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", value))
    return Dumper

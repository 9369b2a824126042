"""Scene files of a rig, complete and as a preview, as the report shows and offers them."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scenetruth.design.optimisation.confirmation import ReducedScene, reduce_scene
from scenetruth.design.optimisation.design_records import RigDesign
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.specification import ConfirmationSpec
from scenetruth.scene import Scene

__all__ = ["PREVIEW_FILE", "SceneFile", "build_preview", "build_preview_file", "build_scene_file", "format_yaml"]


PREVIEW_FILE = "recommended_preview.yaml"
"""File of the preview."""


def build_preview(design: DesignResult) -> ReducedScene:
    """Return what is rendered quickly of the recommended rig: that of which simulations are made."""
    max_size_px = (design.specification.get("confirmation") or {}).get("max_size_px") or ConfirmationSpec().max_size_px
    return reduce_scene(Scene.from_dict(design.recommended.scene), design.objectives[0].region, max_size_px)


@dataclass(frozen=True)
class SceneFile:
    """A scene file that is part of a page.

    ``name``: What it is called when it is saved.
    ``text``: What it holds, in YAML.
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


def build_scene_file(rig: RigDesign, name: str) -> SceneFile:
    """Return the scene file of a rig."""
    return SceneFile(name, format_yaml(rig.scene))


def build_preview_file(design: DesignResult) -> SceneFile:
    """Return the file of a scene that shows a part of what the recommended rig sees."""
    return SceneFile(PREVIEW_FILE, format_yaml(build_preview(design).plain))


def format_yaml(plain: Mapping[str, Any]) -> str:
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

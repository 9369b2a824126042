"""Scene files of a rig in the report, complete and as a preview."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenetruth.design.optimisation.confirmation import ReducedScene, reduce_scene
from scenetruth.design.optimisation.design_records import RigDesign
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.specification import ConfirmationSpec
from scenetruth.errors import SceneError
from scenetruth.number_format import format_duration, format_two_digits
from scenetruth.pipeline import estimate_run_cost
from scenetruth.resources import (
    Forecast,
    Limits,
    inspect_machine,
    limited_objects,
    machine_problems,
)
from scenetruth.scene import Scene

__all__ = [
    "PREVIEW_FILE", "SceneFile", "build_preview", "build_preview_file", "build_scene_file", "describe_cost",
    "find_cost_problems", "format_yaml",
]  # fmt: skip


_GB = 1e9
PREVIEW_FILE = "recommended_preview.yaml"
"""Name of the preview file."""


def build_preview(design: DesignResult) -> ReducedScene:
    """Return the scene of reduced cost of the recommended rig, as in the confirmation runs."""
    max_size_px = (design.specification.get("confirmation") or {}).get("max_size_px") or ConfirmationSpec().max_size_px
    return reduce_scene(Scene.from_dict(design.recommended.scene), design.objectives[0].region, max_size_px)


def _forecast(scene: Scene) -> Forecast:
    return estimate_run_cost(scene, limited_objects(scene, Limits(), Path()))


def describe_cost(scene: Scene) -> str:
    """Return the estimated cost of a run of all images, as text.

    The time is at reference speed: files of equal designs are equal on all machines.
    """
    try:
        cost = _forecast(scene)
    except SceneError as error:
        return f"exceeds the default limits: {'; '.join(map(str, error.problems))}"
    memory, disk = (format_two_digits(each / _GB) for each in (cost.memory_bytes, cost.disk_bytes))
    time = format_duration(cost.reference_seconds)
    return f"takes about {time} of processor time at reference speed, {memory} GB of memory and {disk} GB of disk space"


def find_cost_problems(scene: Scene) -> list[str]:
    """Return the reasons why this machine, with the default limits, rejects a run of all images."""
    try:
        return [str(each) for each in machine_problems(_forecast(scene), inspect_machine(Path()), Limits())]
    except SceneError as error:
        return [str(each) for each in error.problems]


@dataclass(frozen=True)
class SceneFile:
    """A scene file embedded in a page: file name and YAML text."""

    name: str
    text: str

    @property
    def address(self) -> str:
        """The file as a data URL for download."""
        return "data:application/yaml;base64," + base64.b64encode(self.text.encode("utf-8")).decode("ascii")

    @property
    def commands(self) -> tuple[tuple[str, str], ...]:
        """Commands for the file, each with a title."""
        stem = self.name.removesuffix(".yaml")
        return (
            ("Simulate, estimate and score", shlex.join(["scenetruth", "run", self.name, "-o", f"outputs/{stem}"])),
            ("Compute the uncertainty budget", shlex.join(["scenetruth", "design", "budget", self.name])),
        )


def build_scene_file(rig: RigDesign, name: str) -> SceneFile:
    """Return the scene file of a rig."""
    return SceneFile(name, format_yaml(rig.scene))


def build_preview_file(design: DesignResult) -> SceneFile:
    """Return the scene file of the preview."""
    return SceneFile(PREVIEW_FILE, format_yaml(build_preview(design).plain))


def format_yaml(plain: Mapping[str, Any]) -> str:
    """Return plain data as YAML, unsorted, with flat lists on one line."""
    import yaml

    text: str = yaml.dump(dict(plain), Dumper=_dumper(), sort_keys=False, allow_unicode=True, width=100)
    return text


def _dumper() -> Any:
    """Return a YAML dumper that writes flat lists on one line."""
    import yaml

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

        def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> Any:
            plain = all(not isinstance(item, list | tuple | dict) for item in sequence)
            return super().represent_sequence(tag, sequence, flow_style=plain)

    Dumper.add_representer(tuple, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", value))
    return Dumper

"""Checks before a run: the methods, and whether they can estimate the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING

from scenetruth.errors import Problem
from scenetruth.estimators import MethodChoice, StreamingMethod, find_method, requirements
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.provenance import blank_recording
from scenetruth.resources import MethodWorkload, RecordingWorkload
from scenetruth.scene import Scene

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["compute_method_workload", "compute_recording_workload", "method_choices", "run_problems"]


def method_choices(scene: Scene, methods: Sequence[MethodSpec]) -> list[MethodChoice]:
    """Return methods with their settings: those of the scene for its own method, otherwise the defaults.

    Names of methods that are not installed are valid within `scenetruth.estimators.method_specs.offered_methods`.
    """
    own = scene.estimate
    if not methods:
        return [own]
    return list({one.label: one.choice(own) for one in methods}.values())


def run_problems(scene: Scene, choices: Sequence[MethodChoice]) -> list[Problem]:
    """Return the problems that prevent methods from estimating the future recording of a scene."""
    blank = blank_recording(scene)
    found = [
        problem for choice in choices for problem in requirements(blank, find_method(choice.method), choice.settings)
    ]
    return list(dict.fromkeys(found))


def compute_method_workload(choices: Sequence[MethodChoice]) -> MethodWorkload:
    """Return the maximum workload of methods that run consecutively."""
    efforts = []
    for choice in choices:
        method = find_method(choice.method)
        if isinstance(method, StreamingMethod):
            names = [field.name for field in fields(MethodWorkload) if field.name != "in_memory"]
            efforts.append(MethodWorkload(**{name: getattr(method, name) for name in names}))
        else:
            efforts.append(MethodWorkload(in_memory=True))
    if not efforts:
        return MethodWorkload()
    most = max(efforts, key=lambda effort: effort.bytes_per_pixel)
    seconds = sum(effort.seconds_per_sample for effort in efforts)
    return replace(most, in_memory=any(effort.in_memory for effort in efforts), seconds_per_sample=seconds)


def compute_recording_workload(recording: xr.Dataset, effort: MethodWorkload | None = None) -> RecordingWorkload:
    """Return the parameters that determine the workload of a recording."""
    sizes = recording["image"].sizes
    return RecordingWorkload(
        pixels=sizes["y"] * sizes["x"],
        positions=sizes["s"] * sizes.get("s_y", 1),
        frames=sizes["t"],
        sample_bytes=recording["image"].dtype.itemsize,
        channels=sizes.get("channel", 1),
        effort=effort or MethodWorkload(),
    )

"""Which methods a run takes, and whether they can estimate what will be recorded, before anything is made."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators import MethodChoice, StreamingMethod, choose, find_method, requirements
from scenetruth.provenance import blank_recording
from scenetruth.resources import Recorded
from scenetruth.scene import Scene

__all__ = ["method_choices", "recorded_of", "run_problems", "streams"]


def method_choices(scene: Scene, methods: Sequence[str | MethodChoice]) -> list[MethodChoice]:
    """Return methods with their settings: the scene's for the scene's own method, defaults for others.

    Raises
    ------
    EstimateError
        If there is no such method.
    """
    own = scene.estimate
    if not methods:
        return [own]
    return [
        item if isinstance(item, MethodChoice) else own if item == own.method else choose({"method": item})
        for item in dict.fromkeys(methods)
    ]


def run_problems(scene: Scene, choices: Sequence[MethodChoice]) -> list[Problem]:
    """Return what will keep methods from estimating the recording of a scene, before it is made."""
    blank = blank_recording(scene)
    found = [
        problem for choice in choices for problem in requirements(blank, find_method(choice.method), choice.settings)
    ]
    return list(dict.fromkeys(found))


def streams(choice: MethodChoice) -> bool:
    """Return whether a method estimates some frames at a time."""
    return isinstance(find_method(choice.method), StreamingMethod)


def recorded_of(recording: xr.Dataset, *, in_memory: bool = False) -> Recorded:
    """Return what the work on a recording grows with.

    Parameters
    ----------
    recording
        The recording.
    in_memory
        Whether the method of estimation holds all frames.
    """
    sizes = recording["image"].sizes
    return Recorded(
        pixels=sizes["y"] * sizes["x"],
        positions=sizes["s"] * sizes.get("s_y", 1),
        frames=sizes["t"],
        sample_bytes=recording["image"].dtype.itemsize * sizes.get("channel", 1),
        in_memory=in_memory,
    )

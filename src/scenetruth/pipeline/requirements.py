"""Which methods a run takes, and whether they can estimate what will be recorded, before anything is made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from scenetruth.camera import chain_of
from scenetruth.errors import Problem
from scenetruth.estimators import MethodChoice, choose, find_method, requirements
from scenetruth.provenance import intrinsics_from
from scenetruth.scene import Scene
from scenetruth.schema import make_recording

__all__ = ["method_choices", "run_problems"]


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
    blank = _blank_recording(scene)
    found = [
        problem for choice in choices for problem in requirements(blank, find_method(choice.method), choice.settings)
    ]
    return list(dict.fromkeys(found))


def _blank_recording(scene: Scene) -> xr.Dataset:
    """Return the recording of a scene with images that take no memory: all of their pixels are one."""
    camera, stage, dtype = scene.camera, scene.stage, chain_of(scene.sensor).dtype
    rows = () if stage.rows == 1 else (stage.rows,)
    shape = (*rows, stage.positions, scene.frames.count, camera.height, camera.width)
    intrinsics = intrinsics_from(scene)
    return make_recording(
        np.broadcast_to(np.zeros((), dtype=dtype), shape),
        intrinsics.focal_length_px,
        intrinsics.baseline_mm,
        intrinsics.principal_point_px,
        intrinsics.frame_interval_s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if rows else None,
    )

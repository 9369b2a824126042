"""The choice of working points: as given, from the images, or from an estimate at half the resolution."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from scenetruth.estimators.structure_tensor.registration import (
    Registration,
    find_working_point,
    find_working_point_of_flow,
    registrations_along_surfaces,
    registrations_from_coarse,
)
from scenetruth.estimators.structure_tensor.rig import requirements
from scenetruth.estimators.structure_tensor.run import run
from scenetruth.estimators.structure_tensor.task import Task, largest_disparity

__all__ = ["choose_registrations"]


def choose_registrations(task: Task) -> list[Registration]:
    """Choose the working points: as given, from the images, or from an estimate at half the resolution.

    Parameters
    ----------
    task
        Images and settings.

    Returns
    -------
    list of Registration
        The working points that are tried; at least one.
    """
    settings, rig, images = task.settings, task.rig, task.images
    frame = int(task.outputs[len(task.outputs) // 2])
    camera = int(np.argmin(np.abs(rig.positions)))
    largest = largest_disparity(task)
    disparity, flow = settings.working_point_px, settings.flow_working_point_px
    if not rig.sees_depth:
        disparity = 0
    if not rig.sees_motion:
        flow = (0, 0)
    coarse: list[Registration] = []
    if settings.pyramid_levels > 0 and (disparity == "per_pixel" or flow == "auto"):
        coarse = [
            Registration(
                disparity if isinstance(disparity, int) else item.disparity,
                flow if flow != "auto" else item.flow,
                item.cells,
                item.fits,
            )
            for item in _coarse_registrations(task, frame, largest)
        ]
    flows: list[tuple[int, int]]
    if flow == "auto":
        frames = images[:, camera, frame - rig.before : frame - rig.before + rig.frames]
        most = find_working_point_of_flow(frames)
        flows = [(0, 0)] if most == (0, 0) else [(0, 0), most]
    else:
        flows = [flow]
    if disparity == "per_pixel":
        along = registrations_along_surfaces(images[:, :, frame], rig.positions, largest)
        # A coarse estimate does not see fine texture: what the images tell by themselves is tried as well.
        return _merge([*(replace(one, flow=item) for item in flows for one in along), *coarse])
    if disparity == "auto":
        disparity = find_working_point(np.concatenate(images[:, :, frame], axis=1), rig.positions)
    return _merge([*(Registration(int(disparity), item) for item in flows), *coarse])


def _merge(registrations: Iterable[Registration]) -> list[Registration]:
    """Join the cells of equal registrations."""
    merged: dict[tuple[int, tuple[int, int]], Registration] = {}
    for item in registrations:
        key = (item.disparity, item.flow)
        known = merged.get(key, item)
        merged[key] = replace(item, cells=_either(known.cells, item.cells), fits=_either(known.fits, item.fits))
    return list(merged.values())


def _either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    return other if one is None or other is None else one | other


def _coarse_registrations(task: Task, frame: int, largest: int) -> list[Registration]:
    """Estimate one frame at half the resolution, and return the registrations for what it finds."""
    smaller = _halve(task.images[:, :, frame - task.rig.before : frame - task.rig.before + task.rig.frames])
    settings = task.settings.model_copy(
        update={
            "pyramid_levels": task.settings.pyramid_levels - 1,
            "working_point_px": "per_pixel",
            "flow_working_point_px": "auto",
            "tau": 0.0,
        }
    )
    fine = task.intrinsics
    (c_x, c_y), height, width = fine.principal_point_px, *smaller.shape[-2:]
    if requirements(settings, 2, 2, width, height):
        return []
    coarse = replace(
        task,
        images=smaller,
        settings=settings,
        intrinsics=replace(fine, focal_length_px=fine.focal_length_px / 2, principal_point_px=(c_x / 2, c_y / 2)),
        outputs=task.rig.outputs(smaller.shape[2]),
    )
    maps = run(coarse, choose_registrations(coarse), None)
    known = maps.kind[0] > 0
    disparity = np.nan_to_num(maps.disparity[0])
    flow = np.nan_to_num(maps.flow[:, 0])
    return registrations_from_coarse(disparity, flow, known, task.images.shape[-2:], largest)


def _halve(images: NDArray[Any]) -> NDArray[np.float32]:
    """Smooth and take every second row and column."""
    weights = np.array([1, 4, 6, 4, 1], dtype=np.float32) / 16
    rows = correlate1d(images.astype(np.float32), weights, axis=-2, mode="nearest")[..., ::2, :]
    return np.ascontiguousarray(correlate1d(rows, weights, axis=-1, mode="nearest")[..., ::2])

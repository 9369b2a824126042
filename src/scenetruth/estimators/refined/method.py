"""Method ``refined`` over the frames of a recording."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError
from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.acquisition import corrects_poses
from scenetruth.estimators.refined.common_uncertainty import has_common_part
from scenetruth.estimators.refined.image_stack import FramesNeeded, frames_needed
from scenetruth.estimators.refined.output_maps import CORRECTIONS, list_camera_counts, list_map_types
from scenetruth.progress import Progress
from scenetruth.schema import Put, blank_map, label, read_intrinsics

if TYPE_CHECKING:
    from scenetruth.estimators.refined.pose_consistency import PoseErrors

__all__ = ["blank_estimate", "fill_estimate"]


def blank_estimate(recording: xr.Dataset, settings: RefinedSettings) -> xr.Dataset:
    """Return the estimate of a recording with blank maps."""
    sizes = recording["image"].sizes
    places = [frames.output for frames in _needed(sizes["t"], settings)]
    shape = (len(places), sizes["y"], sizes["x"])
    frames = min(sizes["t"], settings.window_frames)
    common = has_common_part(recording, settings)
    types = list_map_types(sizes.get("s_y", 1) * sizes["s"], frames, settings, common=common)
    x, y = (recording[name].values if name in recording.coords else None for name in ("x", "y"))
    maps = {name: blank_map(dtype, (*components, *shape)) for name, (components, dtype) in types.items()}
    cameras: dict[str, Any] = {}
    if corrects_poses(recording, settings):
        for name, components in CORRECTIONS.items():
            maps[name] = blank_map(np.float64, (*components, *list_camera_counts(recording), len(places)))
        names = ("s", "stage_x_mm", *(("stage_y_mm",) if "s_y" in recording["image"].dims else ()))
        cameras = {name: recording[name].values for name in names}
    times = recording["t"].values[places]
    return label("estimate", maps, read_intrinsics(recording), t=times, x=x, y=y, **cameras)


def fill_estimate(
    recording: xr.Dataset, settings: RefinedSettings, put: Put, progress: Progress | None = None
) -> dict[str, Any]:
    """Estimate surface and motion of every pixel, frame by frame."""
    from scenetruth.estimators.refined.frame_task import FrameTask
    from scenetruth.estimators.refined.image_consistency import ExclusionReport
    from scenetruth.estimators.refined.pose_consistency import warn_of_pose_errors
    from scenetruth.memory import retained_memory

    task = FrameTask(recording, settings)
    needed = _needed(task.reader.shape[2], settings)
    rounds, curved, noted = [], [], ExclusionReport(recording)
    unstated: list[PoseErrors | None] = []
    for number, frames in enumerate(needed):
        tiles = len(task.tiles)
        steps = (1 if tiles == 1 else tiles + 1) * settings.max_iterations
        entries = None if progress is None else _later(progress, number, len(needed), steps)
        if entries is not None:
            entries(0)
        try:
            # Tiles bound the memory.
            with retained_memory() if tiles == 1 else nullcontext():
                found = task.estimate(frames, entries)
        except EstimateError as error:
            noted.report_invalid_frame(frames.output, error.problems[0].message)
            found = task.estimate_nothing(frames)
        noted.leave_out(frames.first, found.left_out)
        unstated.append(found.errors)
        maps = found.maps | found.corrections
        found.maps.clear()
        # Maps are released one by one, because the estimate holds copies.
        for name in list(maps):
            put(name, {"t": number}, maps.pop(name))
        rounds.append(found.rounds)
        curved.append(found.curved)
        if entries is not None:
            entries(steps)
    warn_of_pose_errors(unstated, task.grid.step_px)
    return {
        "iterations": rounds,
        "curved_fraction": curved,
        "excluded_pixel_counts": task.reader.counts,
        **noted.attributes(),
    }


def _needed(count: int, settings: RefinedSettings) -> list[FramesNeeded]:
    return frames_needed(count, settings.window_frames, every=settings.frames == "all")


def _later(progress: Progress, number: int, frames: int, steps: int) -> Callable[[int], None]:
    """Return a function that reports the iterations of one frame as part of the total progress."""
    return lambda done: progress("estimate", number * steps + done, frames * steps)

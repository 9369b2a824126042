"""The paper's estimator: one 4D structure tensor gives disparity and 3D motion of every pixel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.frame_reader import FrameReader
from scenetruth.estimators.structure_tensor.filters import PAPER
from scenetruth.estimators.structure_tensor.maps import Maps
from scenetruth.estimators.structure_tensor.rig import Rig, requirements, rig_of
from scenetruth.estimators.structure_tensor.run import frames_at_a_time, run, step_count
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.task import Task, check_common_view, make_task
from scenetruth.estimators.structure_tensor.threshold import DimPixels, with_threshold
from scenetruth.estimators.structure_tensor.working_points import choose_registrations
from scenetruth.progress import Progress
from scenetruth.schema import PixelGrid, Put, blank_map, intrinsics_of, label, pixel_grid_of

__all__ = ["blank_estimate", "fill_estimate"]

# Maps of the estimate: their dimensions beside frame and pixels, and their type.
_MAPS: Mapping[str, tuple[tuple[int, ...], DTypeLike]] = {
    "depth": ((), np.float32),
    "velocity": ((3,), np.float32),
    "disparity": ((), np.float32),
    "flow": ((2,), np.float32),
    "divergence": ((), np.float32),
    "kind": ((), np.uint8),
    "kind_disparity": ((), np.uint8),
    "kind_motion": ((), np.uint8),
    "model_violation": ((), np.bool_),
    "depth_std": ((), np.float32),
    "velocity_std": ((3,), np.float32),
    "disparity_std": ((), np.float32),
    "confidence": ((), np.float32),
    "working_point": ((), np.float32),
    "eigenvalues": ((5,), np.float32),
}
_IN_PIXELS = ("disparity", "flow", "disparity_std", "working_point")


def blank_estimate(recording: xr.Dataset, settings: StructureTensorSettings) -> xr.Dataset:
    """Return the estimate of a recording with maps that are still blank.

    Parameters
    ----------
    recording
        A checked recording, of all pixels of the camera, of a part of them, or of every n-th (`pixel_grid_of`).
    settings
        Window along t, which decides the frames.

    Returns
    -------
    xarray.Dataset
        An estimate for every frame whose window lies inside the recording, at the recording's pixels.

    Raises
    ------
    RecordingError
        If the recording's pixels are no even grid.
    EstimateError
        If the recording is too small for the filters, or the positions of its cameras are impossible.
    """
    rig = _rig(recording, settings)
    outputs = rig.outputs(recording.sizes["t"])
    shape = (len(outputs), recording.sizes["y"], recording.sizes["x"])
    return label(
        "estimate",
        {name: blank_map(dtype, (*components, *shape)) for name, (components, dtype) in _MAPS.items()},
        intrinsics_of(recording),
        t=recording["t"].values[outputs],
        **{name: recording[name].values for name in ("x", "y") if name in recording.coords},
        attrs={
            **{key: recording.attrs[key] for key in ("scene", "scene_hash") if key in recording.attrs},
            "method": "structure_tensor",
            "settings": settings.model_dump_json(),
            "filters_s": rig.over_s.name,
            "filters_t": rig.over_t.name,
            "filters_xy": PAPER.name,
            "window_taps_frames": len(rig.window_t),
        },
    )


def fill_estimate(
    recording: xr.Dataset, settings: StructureTensorSettings, put: Put, progress: Progress | None = None
) -> dict[str, Any]:
    """Estimate depth, disparity, flow and velocity with the 4D structure tensor (paper, sections 2 to 4).

    Frames are read and estimated in groups, so that memory does not grow with their number.

    Parameters
    ----------
    recording
        As of `blank_estimate`.
    settings
        Window, threshold and working points; windows count in columns of the recording, working points in the
        camera's pixels.
    put
        Takes the maps of `blank_estimate`. Pixels whose filters and window do not lie inside the registered images are
        NaN with ``kind`` none. One camera gives no depth and no velocity, one frame neither flow nor velocity.
        Disparity and flow are in the camera's pixels.
    progress
        Called with (what, done, total).

    Returns
    -------
    dict
        Attributes: the working points, the threshold, the noise.

    Raises
    ------
    RecordingError
        If the recording's pixels are no even grid.
    EstimateError
        If the recording is too small for the filters, or the working point leaves no common view.

    Warns
    -----
    EstimateWarning
        If the threshold τ is too high for many pixels.
    """
    rig = _rig(recording, settings)
    images = FrameReader(recording)
    missing = images.missing()
    if missing:
        message = f"holds {missing} values that are not finite in float32; the filters would spread them"
        raise EstimateError([Problem("image", message)])
    # The filters work in columns and rows of the recording, not in pixels of the camera.
    grid, intrinsics = pixel_grid_of(recording), intrinsics_of(recording)
    outputs, groups = rig.outputs(images.shape[2]), _groups(rig, images)
    middle = int(outputs[len(outputs) // 2]) - rig.before
    task = make_task(
        images.frames(middle, middle + rig.frames),
        rig,
        _in_columns(settings, grid),
        grid.in_columns(intrinsics),
        float(recording.attrs["full_scale"]),
    )
    registrations = choose_registrations(task)
    check_common_view(task, registrations)
    task, sigma = with_threshold(_at(task, images, groups[0]), registrations)
    dim, usual = DimPixels(task), Counter[int]()
    steps = [step_count(len(group), images.shape[-2:]) * len(registrations) for group in groups]
    for number, group in enumerate(groups):
        told = None if progress is None else _later(progress, sum(steps[:number]), sum(steps))
        maps = run(_at(task, images, group), registrations, told)
        if settings.tau != "auto":
            dim.add(maps)
        values, counts = np.unique(maps.working_point[np.isfinite(maps.working_point)], return_counts=True)
        usual.update(dict(zip(values.astype(np.int64).tolist(), counts.tolist(), strict=True)))
        _put(maps, int(group[0]) - rig.before, np.float32(grid.step_px), put, last=group is groups[-1])
        del maps
    if settings.tau != "auto":
        dim.warn_if_many()
    return {
        "working_point_px": _in_pixels(_median(usual, registrations[0].disparity), grid),
        "working_points_px": sorted(
            [_in_pixels(value, grid) for value in (item.disparity, *item.flow)] for item in registrations
        ),
        "tau": float(task.settings.tau),
        **({"noise_std": sigma} if np.isfinite(sigma) else {}),
    }


def _rig(recording: xr.Dataset, settings: StructureTensorSettings) -> Rig:
    """Return the rig of a recording that has been checked for what the estimator needs."""
    sizes = recording["image"].sizes
    count_s, count_t = sizes["s"], sizes["t"]
    problems = requirements(settings, count_s, count_t, sizes["x"], sizes["y"])
    baseline_mm = intrinsics_of(recording).baseline_mm if count_s > 1 else 1.0
    stage_x_mm = recording["stage_x_mm"].values
    positions = stage_x_mm / baseline_mm
    if np.any(np.diff(positions) <= 1e-6):
        message = "must grow with s in the direction of baseline_mm, no two positions the same"
        problems.append(Problem("stage_x_mm", message, stage_x_mm.tolist()))
    elif abs(positions[recording["s"].values == 0][0]) > 1e-6:
        problems.append(Problem("stage_x_mm", "must be 0 at s = 0", stage_x_mm.tolist()))
    if problems:
        raise EstimateError(problems)
    return rig_of(positions, count_t, settings)


def _groups(rig: Rig, images: FrameReader) -> list[NDArray[np.int64]]:
    """Return the frames to estimate, as places along t, in groups of bounded memory."""
    outputs = rig.outputs(images.shape[2])
    count = frames_at_a_time(images.shape[-2:])
    return [outputs[first : first + count] for first in range(0, len(outputs), count)]


def _at(task: Task, images: FrameReader, outputs: NDArray[np.int64]) -> Task:
    """Return a task for some frames, with the images that their filters and windows need."""
    first = int(outputs[0]) - task.rig.before
    window = images.frames(first, first + task.rig.frames + len(outputs) - 1)
    return replace(task, images=window, outputs=outputs - first)


def _later(progress: Progress, before: int, steps: int) -> Progress:
    """Return what reports the progress of one group as that of all."""
    return lambda what, done, _: progress(what, before + done, steps)


def _put(maps: Maps, first: int, step: np.float32, put: Put, *, last: bool) -> None:
    """Put the maps of a group of frames in their places, from a place along t on, in the camera's pixels."""
    for name, (components, dtype) in _MAPS.items():
        values = getattr(maps, name)
        if name in _IN_PIXELS and step != 1:
            values *= step
        for index in range(values.shape[len(components)]):
            put(
                name,
                {"t": first + index},
                values[(*(slice(None) for _ in components), index)].astype(dtype, copy=False),
            )


def _median(counts: Mapping[int, int], otherwise: int) -> int:
    """Return the median of whole numbers, rounded towards zero, from how often each occurs."""
    if not counts:
        return otherwise
    values = np.array(sorted(counts))
    upto = np.cumsum([counts[value] for value in values.tolist()])
    middle = [values[np.searchsorted(upto, place, side="right")] for place in ((upto[-1] - 1) // 2, upto[-1] // 2)]
    return int(sum(middle) / 2)


def _in_columns(settings: StructureTensorSettings, grid: PixelGrid) -> StructureTensorSettings:
    """Return settings whose working points count in columns of the recording, rounded."""
    disparity, flow = settings.working_point_px, settings.flow_working_point_px
    return settings.model_copy(
        update={
            "working_point_px": disparity if isinstance(disparity, str) else round(disparity / grid.step_px),
            "flow_working_point_px": flow if isinstance(flow, str) else tuple(round(u / grid.step_px) for u in flow),
        }
    )


def _in_pixels(columns: int, grid: PixelGrid) -> int | float:
    """Return a number of columns in the camera's pixels, whole if it is."""
    pixels = columns * grid.step_px
    return round(pixels) if pixels == round(pixels) else pixels

"""The paper's estimator: one 4D structure tensor gives disparity and 3D motion of every pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.structure_tensor.filters import PAPER
from scenetruth.estimators.structure_tensor.maps import Maps
from scenetruth.estimators.structure_tensor.registration import Registration
from scenetruth.estimators.structure_tensor.rig import requirements, rig_of
from scenetruth.estimators.structure_tensor.run import run
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.task import check_common_view, make_task, plain_images
from scenetruth.estimators.structure_tensor.threshold import warn_of_high_threshold, with_threshold
from scenetruth.estimators.structure_tensor.working_points import choose_registrations
from scenetruth.progress import Progress
from scenetruth.schema import PixelGrid, intrinsics_of, label, pixel_grid_of

__all__ = ["estimate_structure_tensor"]


def estimate_structure_tensor(
    recording: xr.Dataset, settings: StructureTensorSettings, progress: Progress | None = None
) -> xr.Dataset:
    """Estimate depth, disparity, flow and velocity with the 4D structure tensor (paper, sections 2 to 4).

    Parameters
    ----------
    recording
        A checked recording, of all pixels of the camera, of a part of them, or of every n-th (`pixel_grid_of`).
    settings
        Window, threshold and working points; windows count in columns of the recording, working points in the
        camera's pixels.
    progress
        Called with (what, done, total).

    Returns
    -------
    xarray.Dataset
        An estimate for every frame whose window lies inside the recording, at the recording's pixels. Pixels whose
        filters and window do not lie inside the registered images are NaN with ``kind`` none. One camera gives no
        depth and no velocity, one frame neither flow nor velocity. Disparity and flow are in the camera's pixels.

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
    images = plain_images(recording)
    count_s, count_t, height, width = images.shape[1:]
    problems = requirements(settings, count_s, count_t, width, height)
    intrinsics = intrinsics_of(recording)
    positions = recording["stage_x_mm"].values / (intrinsics.baseline_mm if count_s > 1 else 1.0)
    if np.any(np.diff(positions) <= 1e-6):
        message = "must grow with s in the direction of baseline_mm, no two positions the same"
        problems.append(Problem("stage_x_mm", message, recording["stage_x_mm"].values.tolist()))
    elif abs(positions[recording["s"].values == 0][0]) > 1e-6:
        problems.append(Problem("stage_x_mm", "must be 0 at s = 0", recording["stage_x_mm"].values.tolist()))
    # The sum is quick: it is finite only if all values are. If it overflows, the exact count decides.
    if images.dtype.kind == "f" and not np.isfinite(images.sum()):
        missing = sum(int((~np.isfinite(part)).sum()) for channel in images for part in channel)
    else:
        missing = 0
    if missing:
        problems.append(
            Problem("image", f"holds {missing} values that are not finite in float32; the filters would spread them")
        )
    if problems:
        raise EstimateError(problems)
    rig = rig_of(positions, count_t, settings)
    # The filters work in columns and rows of the recording, not in pixels of the camera.
    grid = pixel_grid_of(recording)
    full_scale = float(recording.attrs["full_scale"])
    task = make_task(images, rig, _in_columns(settings, grid), grid.in_columns(intrinsics), full_scale)
    registrations = choose_registrations(task)
    check_common_view(task, registrations)
    task, sigma = with_threshold(task, registrations)
    maps = run(task, registrations, progress)
    if settings.tau != "auto":
        warn_of_high_threshold(task, maps)
    frames, step = task.outputs, np.float32(grid.step_px)
    return label(
        "estimate",
        {
            "depth": maps.depth,
            "velocity": maps.velocity,
            "disparity": maps.disparity * step,
            "flow": maps.flow * step,
            "divergence": maps.divergence,
            "kind": maps.kind,
            "kind_disparity": maps.kind_disparity,
            "kind_motion": maps.kind_motion,
            "model_violation": maps.model_violation.astype(bool),
            "depth_std": maps.depth_std,
            "velocity_std": maps.velocity_std,
            "disparity_std": maps.disparity_std * step,
            "confidence": maps.confidence,
            "working_point": maps.working_point * step,
            "eigenvalues": maps.eigenvalues,
        },
        intrinsics,
        t=recording["t"].values[frames],
        **{name: recording[name].values for name in ("x", "y") if name in recording.coords},
        attrs={
            **{key: recording.attrs[key] for key in ("scene", "scene_hash") if key in recording.attrs},
            "method": "structure_tensor",
            "settings": settings.model_dump_json(),
            "filters_s": task.over_s.name,
            "filters_t": task.over_t.name,
            "filters_xy": PAPER.name,
            "window_taps_frames": len(rig.window_t),
            "working_point_px": _in_pixels(_usual(maps, registrations), grid),
            "working_points_px": sorted(
                [_in_pixels(value, grid) for value in (item.disparity, *item.flow)] for item in registrations
            ),
            "tau": float(task.settings.tau),
            **({"noise_std": sigma} if np.isfinite(sigma) else {}),
        },
    )


def _usual(maps: Maps, registrations: Sequence[Registration]) -> int:
    """Return the disparity at which most pixels were registered."""
    chosen = maps.working_point[np.isfinite(maps.working_point)]
    return int(np.median(chosen)) if chosen.size else registrations[0].disparity


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

"""The plane sweep over the frames of a recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.frame_reader import FrameReader
from scenetruth.estimators.plane_sweep.settings import PlaneSweepSettings
from scenetruth.estimators.plane_sweep.sweep import sweep
from scenetruth.progress import Progress
from scenetruth.schema import intrinsics_of, pixel_grid_of

__all__ = ["disparities"]


def disparities(
    recording: xr.Dataset, settings: PlaneSweepSettings, progress: Progress | None
) -> Iterator[NDArray[np.float64]]:
    """Give the disparity of the reference camera in every frame, px per step of s, NaN where it is not known.

    Parameters
    ----------
    recording
        A checked recording of several cameras.
    settings
        Which disparities are tried.
    progress
        Called with (what, done, total).

    Raises
    ------
    EstimateError
        If the images hold values that are not finite.
    """
    reader = FrameReader(recording)
    missing = reader.missing()
    if missing:
        message = f"holds {missing} values that are not finite in float32; leave out these rows and columns"
        raise EstimateError([Problem("image", message)])
    baseline_mm = intrinsics_of(recording).baseline_mm
    positions = recording["stage_x_mm"].values / baseline_mm
    step_px, frames = pixel_grid_of(recording).step_px, reader.shape[2]
    ranges = None
    if settings.disparity_px != "auto":
        low, high = sorted(settings.disparity_px)
        ranges = [(low / step_px, high / step_px)]
    tell = progress or (lambda *_: None)
    tell("sweep", 0, frames)
    for frame in range(frames):
        images = reader.frames(frame, frame + 1)[:, :, 0].astype(np.float32, copy=False)
        found = sweep(images, positions, baseline_mm, ranges, settings.distinctness)
        tell("sweep", frame + 1, frames)
        yield np.where(found.known, found.disparity * step_px, np.nan)

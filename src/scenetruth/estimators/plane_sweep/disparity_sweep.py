"""Disparity of every pixel from all cameras: disparity ranges, a single frame, and all frames of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import EstimateError
from scenetruth.estimators.method_settings import PlaneSweepSettings
from scenetruth.estimators.plane_sweep.cost_volume import (
    BestHypothesis,
    CameraRow,
    channel_mean,
    choose_hypotheses,
    downsample,
    spread_hypotheses,
    touching_census,
)
from scenetruth.estimators.protocol import FrameReader
from scenetruth.progress import Progress
from scenetruth.schema import REASONS, compute_pixel_grid, read_intrinsics

__all__ = ["DisparityResult", "estimate_disparities", "sweep_disparity"]


# Smallest ratio of the cost of any other hypothesis to the best cost.
_SURE = 1.5
_COARSEST = 8
_LEAST_WIDTH = 120  # columns required to distinguish disparities
_COMMON, _COMMON_SHARE = 8, 0.125  # smallest overlap of two views, in columns and as a fraction of the width
# Smallest size of a range, in pixels of the low resolution and as a fraction of the image.
_LEAST_PIXELS, _LEAST_SHARE = 6, 2e-4
_WIDER = 1.5  # columns of the low resolution by which ranges are widened
# With a smaller fraction of unique pixels, the texture is too fine for the low resolution, or missing.
_ENOUGH = 0.25
_MOST_COSTS = 5e8


def disparity_ranges(images: NDArray[np.float32], row: CameraRow) -> list[tuple[float, float]]:
    """Return the disparity ranges that occur in images (s, y, x), in columns per step; empty without texture."""
    factor = _COARSEST
    while factor > 1 and images.shape[2] // factor < _LEAST_WIDTH:
        factor //= 2
    ranges: list[tuple[float, float]] = []
    while factor >= 1:
        small = downsample(images, factor)
        height, width = small.shape[1:]
        step = min(0.5, 1 / row.farthest)
        widest = (width - max(_COMMON, _COMMON_SHARE * width)) / float(np.abs(row.nearest).min())
        if widest <= 0 or (ranges and widest / step * height * width > _MOST_COSTS):
            break
        chosen = choose_hypotheses(small, row, spread_hypotheses([(0.0, widest)], step))
        sure = chosen.sure(_SURE)
        seen = ~touching_census(np.isnan(small[row.reference]))
        sure &= seen
        ranges += [(low * factor, high * factor) for low, high in _ranges(chosen, sure, step, widest)]
        if sure.sum() > _ENOUGH * seen.sum():
            break
        factor //= 2
    return ranges


def _ranges(chosen: BestHypothesis, sure: NDArray[np.bool_], step: float, widest: float) -> list[tuple[float, float]]:
    """Return the ranges that contain enough pixels."""
    places = np.rint(chosen.disparity[sure] / step).astype(np.int64)
    counts = np.bincount(np.clip(places, 0, None), minlength=1)
    # Counts within one column on either side.
    reach = round(1 / step)
    around = np.convolve(counts, np.ones(2 * reach + 1))[reach : reach + len(counts)]
    least = max(_LEAST_PIXELS, _LEAST_SHARE * sure.size)
    found = np.flatnonzero((around >= least) & (counts > 0)) * step
    runs = np.split(found, np.flatnonzero(np.diff(found) > _WIDER) + 1) if len(found) else []
    return [(max(float(run[0]) - _WIDER, 0.0), min(float(run[-1]) + _WIDER, widest)) for run in runs]


_BORDER, _AMBIGUOUS = (REASONS.index(name) for name in ("border", "ambiguous_match"))
# Smallest disparity reported, in steps between hypotheses.
_FARTHEST = 0.5
_MEDIAN_PX = 3


@dataclass(frozen=True, eq=False)
class DisparityResult:
    """Result of a plane sweep."""

    disparity: NDArray[np.float64]
    """Disparity in columns per step of s, finite everywhere if any pixel is valid, shape (y, x)."""
    known: NDArray[np.bool_]
    """Validity mask: the match is unique, shape (y, x)."""
    ranges: list[tuple[float, float]]
    far: NDArray[np.bool_]
    """Where the disparity cannot be distinguished from zero, shape (y, x)."""
    ambiguous: NDArray[np.bool_]
    """Where another disparity costs less than ``distinctness`` times the best cost, shape (y, x)."""
    border: NDArray[np.bool_]
    """Where the census window of the reference contains an invalid pixel, shape (y, x)."""


def sweep_disparity(
    images: NDArray[np.float32],
    positions: ArrayLike,
    sign: float = 1.0,
    ranges: Sequence[tuple[float, float]] | None = None,
    distinctness: float = 1.3,
) -> DisparityResult:
    """Estimate the disparity of every pixel of the reference.

    ``images``: Grey values of all cameras in one frame, shape (channel, s, y, x); NaN where invalid. Channels are
      averaged.
    ``ranges``: Disparity ranges to search, in columns per step; estimated from the images if None.
    """
    from scipy import ndimage

    from scenetruth.estimators.plane_sweep.cost_volume import choose_hypotheses, make_camera_row, spread_hypotheses

    row = make_camera_row(positions, sign)
    grey = channel_mean(images)
    turn = 1.0 if sign > 0 else -1.0
    if ranges is None:
        searched = disparity_ranges(grey, row)
    else:
        searched = [(min(low * turn, high * turn), max(low * turn, high * turn)) for low, high in ranges]
    border = touching_census(np.isnan(grey[row.reference]))
    if not searched:
        nowhere = np.zeros(grey.shape[1:], dtype=np.bool_)
        return DisparityResult(np.full(grey.shape[1:], np.nan), nowhere, [], nowhere, nowhere, border)
    chosen = choose_hypotheses(grey, row, spread_hypotheses(searched, _step(row.farthest)))
    disparity = ndimage.median_filter(chosen.disparity, _MEDIAN_PX)
    # Points at infinity, or beyond by noise, have no depth.
    least = _FARTHEST * _step(row.farthest)
    far = disparity <= least
    known = chosen.sure(distinctness) & ~far & ~border
    disparity = np.maximum(disparity, least) * turn
    ranges = [(low * turn, high * turn) for low, high in searched]
    ambiguous = (chosen.distinct <= distinctness) & ~border
    return DisparityResult(disparity, known, ranges, far & ~border, ambiguous, border)


def _step(farthest: float) -> float:
    """Return the distance between hypotheses: 1/4 column in the farthest view, 1/2 column beyond four steps."""
    return min(0.25, max(0.25 / farthest, min(0.125, 0.5 / farthest)))


def estimate_disparities(
    recording: xr.Dataset, settings: PlaneSweepSettings, progress: Progress | None
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.uint8]]]:
    """Yield the disparity in every frame, px per step of s, NaN where invalid, and the reason where it is stated."""
    reader = FrameReader(recording)
    empty = reader.empty_images()
    if empty:
        raise EstimateError(empty)
    baseline_mm = read_intrinsics(recording).baseline_mm
    positions = recording["stage_x_mm"].values / baseline_mm
    step_px, frames = compute_pixel_grid(recording).step_px, reader.shape[2]
    ranges = None
    if settings.disparity_px != "auto":
        low, high = sorted(settings.disparity_px)
        ranges = [(low / step_px, high / step_px)]
    tell = progress or (lambda *_: None)
    tell("sweep", 0, frames)
    for frame in range(frames):
        images = reader.frames(frame, frame + 1)[:, :, 0].astype(np.float32, copy=False)
        found = sweep_disparity(images, positions, baseline_mm, ranges, settings.uniqueness_ratio)
        tell("sweep", frame + 1, frames)
        reason = np.where(found.border, _BORDER, found.ambiguous * _AMBIGUOUS).astype(np.uint8)
        yield np.where(found.known, found.disparity * step_px, np.nan), reason

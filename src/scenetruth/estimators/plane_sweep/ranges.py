"""Which disparities there are in images at all, found at a lower resolution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.plane_sweep.hypotheses import spread
from scenetruth.estimators.plane_sweep.resolution import averaged
from scenetruth.estimators.plane_sweep.views import Row
from scenetruth.estimators.plane_sweep.volume import Chosen, choose

__all__ = ["disparity_ranges"]

# Any other answer must cost this many times as much.
_SURE = 1.5
_COARSEST = 8
# Columns that are enough to tell disparities apart.
_LEAST_WIDTH = 120
# Columns that two views must have in common: as many, and as large a share.
_COMMON, _COMMON_SHARE = 8, 0.125
# Pixels of low resolution that make a range: as many, and as large a share.
_LEAST_PIXELS, _LEAST_SHARE = 6, 2e-4
# Ranges are widened by this many columns of low resolution.
_WIDER = 1.5
# Where a smaller share of pixels is sure, texture is too fine for the low resolution, or missing.
_ENOUGH = 0.25
_MOST_COSTS = 5e8


def disparity_ranges(images: NDArray[np.float32], row: Row) -> list[tuple[float, float]]:
    """Return the ranges of disparity in columns per step that images show; none if they show nothing.

    Parameters
    ----------
    images
        Grey values, shape (s, y, x).
    row
        Which of them is the reference, and where the others stand.
    """
    factor = _COARSEST
    while factor > 1 and images.shape[2] // factor < _LEAST_WIDTH:
        factor //= 2
    ranges: list[tuple[float, float]] = []
    while factor >= 1:
        small = averaged(images, factor)
        height, width = small.shape[1:]
        step = min(0.5, 1 / row.farthest)
        widest = (width - max(_COMMON, _COMMON_SHARE * width)) / float(np.abs(row.nearest).min())
        if widest <= 0 or (ranges and widest / step * height * width > _MOST_COSTS):
            break
        chosen = choose(small, row, spread([(0.0, widest)], step))
        sure = chosen.sure(_SURE)
        ranges += [(low * factor, high * factor) for low, high in _ranges(chosen, sure, step, widest)]
        if sure.mean() > _ENOUGH:
            break
        factor //= 2
    return ranges


def _ranges(chosen: Chosen, sure: NDArray[np.bool_], step: float, widest: float) -> list[tuple[float, float]]:
    """Return the ranges in which there are enough pixels."""
    places = np.rint(chosen.disparity[sure] / step).astype(np.int64)
    counts = np.bincount(np.clip(places, 0, None), minlength=1)
    # As many within a column to either side.
    reach = round(1 / step)
    around = np.convolve(counts, np.ones(2 * reach + 1))[reach : reach + len(counts)]
    least = max(_LEAST_PIXELS, _LEAST_SHARE * sure.size)
    found = np.flatnonzero((around >= least) & (counts > 0)) * step
    runs = np.split(found, np.flatnonzero(np.diff(found) > _WIDER) + 1) if len(found) else []
    return [(max(float(run[0]) - _WIDER, 0.0), min(float(run[-1]) + _WIDER, widest)) for run in runs]

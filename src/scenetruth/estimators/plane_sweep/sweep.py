"""Disparity of every pixel of the reference from all cameras of one frame, from nothing but the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Swept", "sweep"]

# Least disparity that is told, in steps of those that are tried.
_FARTHEST = 0.5
_MEDIAN_PX = 3


@dataclass(frozen=True, eq=False)
class Swept:
    """What a plane sweep finds."""

    disparity: NDArray[np.float64]
    """In columns per step of s, finite everywhere if anything is known, shape (y, x)."""
    known: NDArray[np.bool_]
    """Where the images tell it beyond doubt, shape (y, x)."""
    ranges: list[tuple[float, float]]
    """The ranges that were searched."""
    far: NDArray[np.bool_]
    """Where disparity is nearer to zero than can be told, shape (y, x)."""


def sweep(
    images: NDArray[np.float32],
    positions: ArrayLike,
    sign: float = 1.0,
    ranges: Sequence[tuple[float, float]] | None = None,
    distinctness: float = 1.3,
) -> Swept:
    """Find the disparity of every pixel of the reference.

    Parameters
    ----------
    images
        Grey values of all cameras at one time, finite, shape (channel, s, y, x). Channels are averaged.
    positions
        Where the cameras stand, in steps, one of them at 0: camera s sees at x - d s what the reference sees at x.
    sign
        That of all disparities d: that of the baseline.
    ranges
        Ranges of disparity to search, in columns per step; they are found if not given.
    distinctness
        How many times as much as the chosen disparity any other must cost, lest it is not known.

    Returns
    -------
    Swept
        Pixels are known whose disparity another view would choose too where it sees them, so that they are not hidden
        from all, and for which any other disparity would fit clearly worse.
    """
    from scipy import ndimage

    from scenetruth.estimators.plane_sweep.hypotheses import spread
    from scenetruth.estimators.plane_sweep.ranges import disparity_ranges
    from scenetruth.estimators.plane_sweep.views import row_of
    from scenetruth.estimators.plane_sweep.volume import choose

    row = row_of(positions, sign)
    grey = np.ascontiguousarray(images.mean(axis=0, dtype=np.float32))
    turn = 1.0 if sign > 0 else -1.0
    if ranges is None:
        searched = disparity_ranges(grey, row)
    else:
        searched = [(min(low * turn, high * turn), max(low * turn, high * turn)) for low, high in ranges]
    if not searched:
        nowhere = np.zeros(grey.shape[1:], dtype=np.bool_)
        return Swept(np.full(grey.shape[1:], np.nan), nowhere, [], nowhere)
    chosen = choose(grey, row, spread(searched, _step(row.farthest)))
    disparity = ndimage.median_filter(chosen.disparity, _MEDIAN_PX)
    # What is as far away as anything, or farther, has no depth.
    least = _FARTHEST * _step(row.farthest)
    far = disparity <= least
    known = chosen.sure(distinctness) & ~far
    disparity = np.maximum(disparity, least) * turn
    return Swept(disparity, known, [(low * turn, high * turn) for low, high in searched], far)


def _step(farthest: float) -> float:
    """Return the distance of two hypotheses: a quarter of a column in the farthest view, if that is not too fine.

    Beyond four steps from the reference it is half a column.
    """
    return min(0.25, max(0.25 / farthest, min(0.125, 0.5 / farthest)))

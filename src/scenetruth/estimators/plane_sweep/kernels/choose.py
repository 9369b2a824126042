"""Kernels that choose among the hypotheses of every pixel, and tell how sure the choice is."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from scenetruth.estimators.plane_sweep.kernels.costs import COST_OF_BIT
from scenetruth.estimators.plane_sweep.kernels.narrow import least

__all__ = ["agreeing", "winners"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")
_MOST = np.uint16(65535)
_FLOOR = 8 * 10.0 * COST_OF_BIT  # ten bits on each of eight paths


@_jit
def winners(total: Any, costs: Any, wide: int, place: Any, distinct: Any, own: Any) -> None:
    """Find the hypothesis of least cost of every pixel.

    Parameters
    ----------
    total
        Costs of ways, uint16 of shape (y, x, k).
    costs
        Costs of the pixels themselves, uint8 of the same shape.
    wide
        Hypotheses up to this far from the best are the same answer.
    place
        Output: the best hypothesis, between two by a parabola through three costs, shape (y, x).
    distinct
        Output: how many times as much the best other answer costs, shape (y, x). Ten bits are added to both costs:
        where next to nothing differs, noise would decide.
    own
        Output: the pixel's own cost under the best hypothesis, shape (y, x).
    """
    height, width, count = total.shape
    for y in range(height):
        for x in range(width):
            ways = total[y, x]
            best = _MOST
            for k in range(count):
                best = least(best, ways[k])
            k = 0
            while ways[k] != best:
                k += 1
            other = _MOST
            for n in range(0, max(k - wide, 0)):
                other = least(other, ways[n])
            for n in range(min(k + wide + 1, count), count):
                other = least(other, ways[n])
            found = float(k)
            if 0 < k < count - 1:
                before, after = float(ways[k - 1]), float(ways[k + 1])
                bend = before - 2.0 * float(best) + after
                if bend > 0.0:
                    found += 0.5 * (before - after) / bend
            place[y, x], own[y, x] = found, costs[y, x, k]
            distinct[y, x] = (float(other) + _FLOOR) / (float(best) + _FLOOR)


@_jit
def agreeing(total: Any, shifts: Any, place: Any, tolerance: int, agrees: Any) -> None:
    """Mark pixels whose hypothesis is also what another view would choose where it sees them.

    The costs of that view's pixel x' are those of the reference at x' - shifts[k]: a diagonal through the volume.

    Parameters
    ----------
    total
        Costs, uint16 of shape (y, x, k).
    shifts
        How far to the right the view sees a point, for every hypothesis, in whole px.
    place
        Chosen hypotheses, shape (y, x).
    tolerance
        How many hypotheses the two may be apart.
    agrees
        Output: set where they are not further apart, left where they are; shape (y, x).
    """
    height, width, count = total.shape
    lows = np.empty(width, dtype=np.uint16)
    chosen = np.empty(width, dtype=np.int64)
    for y in range(height):
        lows[:] = _MOST
        chosen[:] = -count
        for x in range(width):
            costs = total[y, x]
            for k in range(count):
                there = x + shifts[k]
                if 0 <= there < width and costs[k] < lows[there]:
                    lows[there] = costs[k]
                    chosen[there] = k
        for x in range(width):
            k = round(place[y, x])
            there = x + shifts[k]
            if 0 <= there < width and abs(chosen[there] - k) <= tolerance:
                agrees[y, x] = True

"""Kernel that tells how well the images agree on every pixel, all of them and those of one side."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import REACH, TAPS, View, weights

__all__ = ["SIDES", "judge_rows"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

SIDES = 5
"""All images; those with s ≤ 0, s ≥ 0, t ≤ 0, t ≥ 0: what hides a point hides it on one side."""
# A variance needs that many images.
_LEAST = 3


@_jit
def judge_rows(
    coefficients: NDArray[np.float32],
    view: View,
    fields: NDArray[np.float64],
    out: NDArray[np.float32],
    rows: tuple[int, int],
) -> None:
    """Compute the variances of the grey values that the images show of every pixel's point.

    Parameters
    ----------
    coefficients, view, fields, rows
        As of `warp.warp_rows`.
    out
        Variances of the images of `SIDES`, NaN where fewer than three show the point, shape (5, height, width).
    """
    count, height, width = coefficients.shape
    wx, wy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
    dx, dy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
    sums = np.empty((SIDES, 3))
    for y in range(rows[0], rows[1]):
        for x in range(width):
            out[:, y, x] = np.nan
            d = fields[0, y, x]
            if np.isnan(d):
                continue
            sums[:] = 0.0
            origin, met = 0.0, False
            for i in range(count):
                s, s_y, t = view.s[i], view.s_y[i], view.t[i]
                scale = 1.0 / (1.0 + t * d * fields[3, y, x] / view.focal)
                at_x = (x - view.centre_x + d * (t * fields[1, y, x] - s)) * scale + view.centre_x
                at_y = (y - view.centre_y + d * (t * fields[2, y, x] - s_y)) * scale + view.centre_y
                if not (at_x >= REACH and at_x < width - 3 and at_y >= REACH and at_y < height - 3):
                    continue
                left, top = int(at_x), int(at_y)
                weights(at_x - left, wx, dx)
                weights(at_y - top, wy, dy)
                value = np.float32(0.0)
                for k in range(TAPS):
                    a = np.float32(0.0)
                    for j in range(TAPS):
                        a += wx[j] * coefficients[i, top + k - REACH, left + j - REACH]
                    value += wy[k] * a
                if not met:
                    origin, met = float(value), True
                v = value - origin
                for side in range(SIDES):
                    if (
                        side == 0
                        or (side == 1 and s <= 0.0)
                        or (side == 2 and s >= 0.0)
                        or (side == 3 and t <= 0.0)
                        or (side == 4 and t >= 0.0)
                    ):
                        sums[side, 0] += 1.0
                        sums[side, 1] += v
                        sums[side, 2] += v * v
            for side in range(SIDES):
                n = sums[side, 0]
                if n >= _LEAST:
                    out[side, y, x] = (sums[side, 2] - sums[side, 1] ** 2 / n) / (n - 1.0)

"""Kernel that tells how well the images agree on every pixel, all of them and those of one side."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import (
    ACCELERATED,
    CUBIC,
    QUINTIC,
    REACH,
    STEADY,
    TAPS,
    View,
    corrected,
    cubic_weights,
    place_of,
    quintic_weights,
)

__all__ = ["SIDES", "judge_rows"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

SIDES = 7
"""All images; those with s ≤ 0, s ≥ 0, t ≤ 0, t ≥ 0, s_y ≤ 0, s_y ≥ 0: what hides a point hides it on one side."""
# A variance needs that many images.
_LEAST = 3


def _compiled(*, accelerated: bool, cubic: bool) -> Any:
    @_jit
    def compiled(
        coefficients: Any, view: Any, fields: Any, bad: Any, gain: Any, offset: Any, block: Any, out: Any, rows: Any
    ) -> None:
        count, height, width = coefficients.shape
        wx, wy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
        dx, dy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
        sums = np.empty((SIDES, 3))
        _, down, across = gain.shape
        some_bad = bad.shape[0] > 0
        for y in range(rows[0], rows[1]):
            for x in range(width):
                out[:, y, x] = np.nan
                if np.isnan(fields[0, y, x]):
                    continue
                sums[:] = 0.0
                # The four middles of blocks around the pixel.
                row = min(max((y + 0.5) / block - 0.5, 0.0), down - 1.0)
                column = min(max((x + 0.5) / block - 0.5, 0.0), across - 1.0)
                above, beside = int(row), int(column)
                below, right = min(above + 1, down - 1), min(beside + 1, across - 1)
                v1, u1 = np.float32(row - above), np.float32(column - beside)
                v0, u0 = np.float32(1.0) - v1, np.float32(1.0) - u1
                origin, met = 0.0, False
                for i in range(count):
                    s, s_y, t = view.s[i], view.s_y[i], view.t[i]
                    at_x, at_y, _ = place_of(accelerated, view, s, s_y, t, fields, y, x)
                    at_x, at_y = corrected(view, i, at_x, at_y)
                    if not (at_x >= REACH and at_x < width - 3 and at_y >= REACH and at_y < height - 3):
                        continue
                    if some_bad and bad[i, int(at_y + 0.5), int(at_x + 0.5)] != 0:
                        continue
                    left, top = int(at_x), int(at_y)
                    # A function for both takes half as much time again.
                    if cubic:
                        cubic_weights(at_x - left, wx, dx)
                        cubic_weights(at_y - top, wy, dy)
                    else:
                        quintic_weights(at_x - left, wx, dx)
                        quintic_weights(at_y - top, wy, dy)
                    value = np.float32(0.0)
                    for k in range(TAPS):
                        a = np.float32(0.0)
                        for j in range(TAPS):
                            a += wx[j] * coefficients[i, top + k - REACH, left + j - REACH]
                        value += wy[k] * a
                    g, o = gain[i], offset[i]
                    scaled = v0 * (u0 * g[above, beside] + u1 * g[above, right])
                    scaled += v1 * (u0 * g[below, beside] + u1 * g[below, right])
                    shifted = v0 * (u0 * o[above, beside] + u1 * o[above, right])
                    shifted += v1 * (u0 * o[below, beside] + u1 * o[below, right])
                    value = (value - shifted) / scaled
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
                            or (side == 5 and s_y <= 0.0)
                            or (side == 6 and s_y >= 0.0)
                        ):
                            sums[side, 0] += 1.0
                            sums[side, 1] += v
                            sums[side, 2] += v * v
                for side in range(SIDES):
                    n = sums[side, 0]
                    if n >= _LEAST:
                        out[side, y, x] = (sums[side, 2] - sums[side, 1] ** 2 / n) / (n - 1.0)

    return compiled


_JUDGES = {
    (fields, order): _compiled(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


def judge_rows(
    coefficients: NDArray[np.float32],
    view: View,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8],
    gain: NDArray[np.float32],
    offset: NDArray[np.float32],
    block: int,
    out: NDArray[np.float32],
    rows: tuple[int, int],
) -> None:
    """Compute the variances of the grey values that the images show of every pixel's point.

    Parameters
    ----------
    coefficients, view, fields, bad, rows
        As of `warp.warp_rows`.
    gain, offset
        What takes the images to one brightness, (value - offset) / gain, in blocks of pixels, shape (n, rows of blocks,
        columns of blocks); linear in between.
    block
        Edge of a block in px.
    out
        Variances of the images of `SIDES`, NaN where fewer than three show the point, shape (7, height, width).
    """
    _JUDGES[len(fields), view.spline](coefficients, view, fields, bad, gain, offset, block, out, rows)

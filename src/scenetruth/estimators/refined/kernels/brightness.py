"""Kernel that takes gains and offsets of their own from images."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["correct_brightness"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@_jit
def _brightness(image: Any, texture: Any, some: Any, window: Any, y: int, step: int, sums: Any, nodes: Any) -> None:
    """Write gain and offset at every n-th column of a row, and at the last, found in the window around it."""
    height, width = image.shape
    reach = window.shape[0] // 2
    sums[:] = 0.0
    for v in range(max(y - reach, 0), min(y + reach + 1, height)):
        if not some[v]:
            continue
        weight = window[v - y + reach]
        for x in range(width):
            g, h = image[v, x], texture[v, x]
            known = not (np.isnan(g) or np.isnan(h))
            w = weight if known else np.float32(0.0)
            a, b = (g, h) if known else (np.float32(0.0), np.float32(0.0))
            at = x + reach
            sums[0, at] += w
            sums[1, at] += w * a
            sums[2, at] += w * b
            sums[3, at] += w * a * b
            sums[4, at] += w * b * b
    for node in range(nodes.shape[1]):
        x = min(node * step, width - 1)
        n, g, h, gh, hh = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(2 * reach + 1):
            weight = window[j]
            n += weight * sums[0, x + j]
            g += weight * sums[1, x + j]
            h += weight * sums[2, x + j]
            gh += weight * sums[3, x + j]
            hh += weight * sums[4, x + j]
        spread = hh * n - h * h
        gain = (gh * n - g * h) / spread if spread > 1e-6 * h * h + 1e-12 else 1.0
        nodes[0, node] = gain if gain > 0.1 else np.nan
        nodes[1, node] = (g - gain * h) / n if n > 0.0 else np.nan


@_jit
def correct_brightness(
    image: NDArray[np.float32],
    texture: NDArray[np.float32],
    window: NDArray[np.float32],
    step: int,
    first_row: int,
    out: NDArray[np.float32],
) -> None:
    """Take a gain and an offset from an image, found in the window around every n-th pixel against the texture.

    Between these pixels, gain and offset are linear: they change over the width of a window.

    Parameters
    ----------
    image
        Warped grey values, NaN where unknown, shape (rows, width).
    texture
        The texture, NaN where unknown, of the same shape.
    window
        Weights along either axis, shape (2 r + 1,).
    step
        n: every n-th row and column of the whole image, and the last ones.
    first_row
        Row of the whole image at which the arrays begin.
    out
        The grey values with the texture's own brightness; NaN where that is not found.
    """
    height, width = image.shape
    sums = np.empty((5, width + window.shape[0] - 1), dtype=np.float32)
    count = (width - 1 + step - 1) // step + 1
    above, below = np.empty((2, count)), np.empty((2, count))
    some = np.empty(height, dtype=np.bool_)
    for y in range(height):
        some[y] = not np.isnan(texture[y]).all()
    top = 0
    _brightness(image, texture, some, window, top, step, sums, above)
    while True:
        bottom = min(top + step - (top + first_row) % step, height - 1)
        _brightness(image, texture, some, window, bottom, step, sums, below)
        for y in range(top, bottom + 1 if bottom == height - 1 else bottom):
            if not some[y]:
                out[y] = np.nan
                continue
            down = (y - top) / (bottom - top) if bottom > top else 0.0
            for x in range(width):
                node = min(x // step, count - 2) if count > 1 else 0
                other = min(node + 1, count - 1)
                gap = min(other * step, width - 1) - node * step
                across = (x - node * step) / gap if gap > 0 else 0.0
                left, right = (1.0 - across) * (1.0 - down), across * (1.0 - down)
                low_left, low_right = (1.0 - across) * down, across * down
                gain = left * above[0, node] + right * above[0, other]
                gain += low_left * below[0, node] + low_right * below[0, other]
                offset = left * above[1, node] + right * above[1, other]
                offset += low_left * below[1, node] + low_right * below[1, other]
                out[y, x] = (image[y, x] - offset) / gain
        if bottom == height - 1:
            return
        top = bottom
        above[:] = below

"""Kernel for the exact area of polygons in the pixels of an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel

__all__ = ["add_edges"]

Array = NDArray[np.float64]


@kernel()
def add_edges(starts: Array, ends: Array, area: Array) -> None:
    """Add the edges of closed polygons to an image of area differences, shape (height, width + 1).

    Pixel (i, j) covers [j, j + 1] x [i, i + 1]. The cumulative sum of a row is the area of the polygons in each pixel,
    positive for polygons that run clockwise with y pointing down. Parts outside the image are clipped.
    """
    height, columns = area.shape
    width = columns - 1
    for number in range(starts.shape[0]):
        x_0, y_0 = starts[number]
        x_1, y_1 = ends[number]
        if y_0 == y_1:
            continue
        # Downward edges have their polygon to the left.
        sign = -1.0
        if y_0 > y_1:
            x_0, y_0, x_1, y_1 = x_1, y_1, x_0, y_0
            sign = 1.0
        slope = (x_1 - x_0) / (y_1 - y_0)
        least, most = min(x_0, x_1), max(x_0, x_1)
        first, last = max(int(np.floor(y_0)), 0), min(int(np.ceil(y_1)), height)
        for row in range(first, last):
            top, bottom = max(y_0, float(row)), min(y_1, float(row + 1))
            if bottom <= top:
                continue
            # Rounding of nearly horizontal edges must not leave the edge.
            left = min(max(x_0 + (top - y_0) * slope, least), most)
            right = min(max(x_0 + (bottom - y_0) * slope, least), most)
            if left > right:
                left, right = right, left
            _add_piece(area[row], width, left, right, sign * (bottom - top))


@subkernel()
def _add_piece(row: Array, width: int, left: float, right: float, rise: float) -> None:
    """Add the part of an edge within one row of pixels: its range of x, and its signed height."""
    if left >= width:
        return
    if right <= 0:
        row[0] += rise
        return
    length = right - left
    if left < 0:
        row[0] += rise * (-left / length)
        rise *= right / length
        left, length = 0.0, right
    if right > width:
        rise *= (width - left) / length
        right = float(width)
        length = right - left
    first, last = int(left), min(int(np.ceil(right)), width)
    if last <= first + 1:
        share = 0.5 * (left + right) - first
        row[first] += rise * (1 - share)
        row[first + 1] += rise * share
        return
    for column in range(first, last):
        low, high = max(left, float(column)), min(right, float(column + 1))
        part = rise * (high - low) / length
        share = 0.5 * (low + high) - column
        row[column] += part * (1 - share)
        row[column + 1] += part * share

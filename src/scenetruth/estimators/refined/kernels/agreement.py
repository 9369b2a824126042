"""Kernel that correlates every image of a block with the mean of the others.

Every image is standardised over its valid pixels first, so that gain, offset and contrast of an image have no effect.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel

__all__ = ["correlate_images"]


# Reassociation and contraction only: NaN must stay NaN.
_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

# Contrast relative to the mean grey value that rounding errors of a constant image may have, and its least value.
_ROUNDING, _LEAST_CONTRAST = 1e-6, 1e-30


@_jit
def _standardise(values: Any, least: float, known: Any, out: Any) -> Any:
    """Write the values minus their mean, over their standard deviation; return their number and the latter.

    ``values``: Grey values of a block, NaN where invalid.
    ``least``: Smallest number of valid pixels; with fewer, all are invalid and the number is 0.
    ``known``: Output: 1 where valid, else 0.
    ``out``: Output: 0 where invalid, and everywhere if there is no contrast, which is returned as 0.
    """
    count, total = 0.0, 0.0
    rows, columns = values.shape
    for y in range(rows):
        line, ones = values[y], known[y]
        for x in range(columns):
            ones[x] = 0.0 if np.isnan(line[x]) else 1.0
        for x in range(columns):
            count += ones[x]
            total += 0.0 if ones[x] == 0.0 else line[x]
    if count < least or count == 0.0:
        known[:], out[:] = 0.0, 0.0
        return 0.0, 0.0
    mean, square = total / count, 0.0
    for y in range(rows):
        line, ones, target = values[y], known[y], out[y]
        for x in range(columns):
            target[x] = 0.0 if ones[x] == 0.0 else line[x] - mean
        for x in range(columns):
            square += target[x] * target[x]
    contrast = np.sqrt(square / count)
    if not contrast > _ROUNDING * abs(mean) + _LEAST_CONTRAST:
        out[:] = 0.0
        return count, 0.0
    share = 1.0 / contrast
    for y in range(rows):
        target = out[y]
        for x in range(columns):
            target[x] *= share
    return count, contrast


@_jit
def _correlate(own: Any, known: Any, sums: Any, used: Any, count: float) -> float:
    """Return the correlation of an image with the mean of the others over its valid pixels; NaN without contrast."""
    total, square, both = 0.0, 0.0, 0.0
    rows, columns = own.shape
    for y in range(rows):
        line, ones, all_of_them, number = own[y], known[y], sums[y], used[y]
        for x in range(columns):
            other = ones[x] * (all_of_them[x] - line[x]) / max(number[x] - 1.0, 1.0)
            total += other
            square += other * other
            both += line[x] * other
    square -= total * total / count
    return both / np.sqrt(square * count) if square > 0.0 else np.nan


@_jit
def correlate_images(
    warped: NDArray[np.float32],
    columns: tuple[int, int],
    least_share: float,
    correlations: NDArray[np.float64],
    contrasts: NDArray[np.float64],
) -> None:
    """Compute the correlation of every image with the mean of the others in a block, and its contrast.

    ``warped``: Grey values, NaN where invalid, shape (n, rows, width).
    ``columns``: First and last column + 1 of the block.
    ``least_share``: Smallest valid fraction of the block of an image.
    ``correlations``: Output: 0 for an image without contrast, NaN for one with too few valid pixels, shape (n,).
    ``contrasts``: Output: standard deviations of the grey values, NaN for an image with too few valid pixels.
    """
    count, rows = warped.shape[:2]
    first, last = columns
    shape = (rows, last - first)
    plain, known = np.empty((count, *shape)), np.empty((count, *shape))
    sums, used, numbers = np.zeros(shape), np.zeros(shape), np.empty(count)
    for n in range(count):
        numbers[n], contrast = _standardise(
            warped[n, :, first:last], least_share * rows * (last - first), known[n], plain[n]
        )
        contrasts[n] = contrast if numbers[n] > 0.0 else np.nan
        if contrast == 0.0:
            continue
        for y in range(rows):
            for x in range(last - first):
                sums[y, x] += plain[n, y, x]
                used[y, x] += known[n, y, x]
    for n in range(count):
        correlations[n] = np.nan if numbers[n] == 0.0 else 0.0
        # An image without contrast is inconsistent.
        if numbers[n] > 0.0 and contrasts[n] > 0.0:
            correlations[n] = _correlate(plain[n], known[n], sums, used, numbers[n])

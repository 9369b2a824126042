"""Kernels that compare neighbourhoods of the reference with those of the other views."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from scenetruth.estimators.plane_sweep.kernels.narrow import add, ones

__all__ = ["COST_OF_BIT", "OTHER_SIDE", "PHASES", "UNSEEN", "census", "fill_costs", "shifted"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")

PHASES = 8
"""Fractions of a pixel by which views are shifted."""
COST_OF_BIT = 4
"""Cost of one bit that differs of the 48."""
OTHER_SIDE = 0.1
"""Weight of the side that agrees less, which steadies what both see."""
UNSEEN = 64
"""Cost where no view sees a point: better than what chance finds, worse than what is found."""
_REACH = 3
_SIDE = 2 * _REACH + 1


@_jit
def shifted(image: Any, phase: int, out: Any) -> None:
    """Shift an image to the left by phase / PHASES px, by cubic convolution (Catmull-Rom); its edges go on.

    Parameters
    ----------
    image
        Shape (y, x), float32.
    phase
        From 0 to PHASES - 1.
    out
        Output, of the same shape.
    """
    height, width = image.shape
    f = np.float32(phase / PHASES)
    half, one = np.float32(0.5), np.float32(1.0)
    a = half * f * (-one + f * (np.float32(2.0) - f))
    b = one + half * f * f * (np.float32(-5.0) + np.float32(3.0) * f)
    c = half * f * (one + f * (np.float32(4.0) - np.float32(3.0) * f))
    d = half * f * f * (f - one)
    for y in range(height):
        for x in range(width):
            if 1 <= x < width - 2:
                out[y, x] = a * image[y, x - 1] + b * image[y, x] + c * image[y, x + 1] + d * image[y, x + 2]
            else:
                right = min(x + 1, width - 1)
                far = min(x + 2, width - 1)
                out[y, x] = a * image[y, max(x - 1, 0)] + b * image[y, x] + c * image[y, right] + d * image[y, far]


@_jit
def census(image: Any, out: Any) -> None:
    """Write which of the 7 x 7 pixels around each are darker than it, as 48 bits; an image's edges go on.

    Parameters
    ----------
    image
        Shape (y, x), float32.
    out
        Output, uint64 of the same shape.
    """
    height, width = image.shape
    rows = np.empty((2 * _REACH + 1, width + 2 * _REACH), dtype=np.float32)
    halves = np.empty((2, width), dtype=np.uint32)
    for y in range(height):
        for i in range(2 * _REACH + 1):
            row = image[min(max(y + i - _REACH, 0), height - 1)]
            rows[i, :_REACH] = row[0]
            rows[i, _REACH : width + _REACH] = row
            rows[i, width + _REACH :] = row[width - 1]
        halves[:] = np.uint32(0)
        centre = image[y]
        for n in range(_SIDE * _SIDE):
            i, j = n // _SIDE, n % _SIDE
            if i == _REACH and j == _REACH:
                continue
            half = halves[1 if i > _REACH or (i == _REACH and j > _REACH) else 0]
            other = rows[i, j : j + width]
            for x in range(width):
                darker = np.uint32(1) if other[x] < centre[x] else np.uint32(0)
                half[x] = add(add(half[x], half[x]), darker)
        for x in range(width):
            out[y, x] = (np.uint64(halves[0, x]) << np.uint64(24)) | np.uint64(halves[1, x])


@_jit
def fill_costs(reference: Any, views: Any, whole: Any, phase: Any, left: int, out: Any) -> None:
    """Compare the reference with all views under every hypothesis.

    Of the views to the left of the reference and those to its right, the side that agrees better counts, and little
    the other: what hides a point from some cameras mostly does so on one side.

    Parameters
    ----------
    reference
        Census of the reference, shape (y, x).
    views
        Census of the other views, shifted by every phase, shape (view, phase, y, x); those on one side come first.
    whole, phase
        Where view v sees the point of column x under hypothesis k: at x + whole[k, v] + phase[k, v] / PHASES.
    left
        How many views stand on the first side.
    out
        Output: COST_OF_BIT times the mean number of bits that differ; UNSEEN where no view sees the point; uint8 of
        shape (y, x, k).
    """
    height, width = reference.shape
    count = whole.shape[0]
    bits = np.empty((2, width), dtype=np.uint32)
    seen = np.empty((2, width), dtype=np.uint32)
    row = np.empty((count, width), dtype=np.uint8)
    scale, near, far = np.float32(COST_OF_BIT), np.float32(1.0 - OTHER_SIDE), np.float32(OTHER_SIDE)
    for y in range(height):
        here = reference[y]
        for k in range(count):
            bits[:], seen[:] = np.uint32(0), np.uint32(0)
            for v in range(len(views)):
                shift = whole[k, v]
                first, last = max(-shift, 0), min(width - shift - (1 if phase[k, v] > 0 else 0), width)
                if first >= last:
                    continue
                there = views[v, phase[k, v], y, first + shift : last + shift]
                place = here[first:last]
                side = 0 if v < left else 1
                sums, numbers = bits[side, first:last], seen[side, first:last]
                for x in range(last - first):
                    sums[x] = add(sums[x], np.uint32(ones(place[x] ^ there[x])))
                    numbers[x] = add(numbers[x], np.uint32(1))
            for x in range(width):
                a, b = np.float32(bits[0, x]), np.float32(bits[1, x])
                m, n = np.float32(seen[0, x]), np.float32(seen[1, x])
                one, two = scale * a / m, scale * b / n
                best = one if m > 0 else two
                best = near * min(one, two) + far * max(one, two) if m > 0 and n > 0 else best
                row[k, x] = np.uint8(best) if m + n > 0 else np.uint8(UNSEEN)
        for x in range(width):
            for k in range(count):
                out[y, x, k] = row[k, x]

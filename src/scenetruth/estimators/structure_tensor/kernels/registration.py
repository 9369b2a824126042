"""A kernel that computes how well the images of neighbouring cameras agree at integer disparities."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["STEP", "matching_costs"]

STEP = 4
"""Distance of the grid points at which images are compared, in px."""

UNSEEN = np.float32(1e30)
"""Cost where no two neighbouring cameras see a place: more than any images differ by."""

# Half the edge of the square over which differences are summed up, in grid points of STEP px.
_HALF = 2

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _row_costs(images: Any, first: Any, second: Any, weights: Any, y: int, out: Any) -> None:
    """Sum up, for blocks of STEP pixels of a row, the squared differences of neighbouring cameras' images.

    Pixels that a camera does not see are not compared: repeated border pixels would match any plain surface.
    """
    width = images.shape[3]
    compared = np.zeros(out.shape[0], dtype=np.float32)
    wanted = np.zeros(out.shape[0], dtype=np.float32)
    out[:] = 0.0
    for channel in range(images.shape[0]):
        for s in range(images.shape[1] - 1):
            a, b = images[channel, s, y], images[channel, s + 1, y]
            for block in range(out.shape[0]):
                start, end = block * STEP, min((block + 1) * STEP, width)
                low = max(start, -first[s], -second[s])
                high = min(end, width - first[s], width - second[s])
                total = np.float32(0.0)
                for x in range(low, high):
                    difference = a[x + first[s]] - b[x + second[s]]
                    total += difference * difference
                out[block] += total * weights[s]
                compared[block] += max(high - low, 0) * weights[s]
                wanted[block] += (end - start) * weights[s]
    for block in range(out.shape[0]):
        # Pixels that some cameras do not see are compared by the others: the sum is scaled to all of them.
        out[block] = out[block] * wanted[block] / compared[block] if compared[block] > 0 else UNSEEN


@_jit
def _smooth(costs: Any, scratch: Any) -> None:
    """Sum costs over a square, in place; outside the image they repeat."""
    rows, columns = costs.shape
    for y in range(rows):
        for x in range(columns):
            total = np.float32(0.0)
            for k in range(-_HALF, _HALF + 1):
                total += costs[y, min(max(x + k, 0), columns - 1)]
            scratch[y, x] = total
    for y in range(rows):
        for x in range(columns):
            costs[y, x] = 0.0
        for k in range(-_HALF, _HALF + 1):
            source = scratch[min(max(y + k, 0), rows - 1)]
            for x in range(columns):
                costs[y, x] += source[x]


@_jit
def matching_costs(
    images: NDArray[np.float32],
    offsets: NDArray[np.int64],
    weights: NDArray[np.float32],
    costs: NDArray[np.float32],
    some: tuple[int, int],
) -> None:
    """Sum up the squared differences of neighbouring cameras' images around every grid point.

    Parameters
    ----------
    images
        Images of one frame, shape (channel, s, y, x).
    offsets
        By how many columns each image is read to the right, for every registration; shape (n, s).
    weights
        What each pair of neighbouring cameras counts, shape (s - 1,).
    costs
        Output, shape (n, y / STEP, x / STEP), rounded up; `UNSEEN` or more where no two neighbours see a place.
    some
        First and last + 1 of the registrations to do.
    """
    for n in range(some[0], some[1]):
        for y in range(costs.shape[1]):
            _row_costs(
                images, offsets[n, :-1], offsets[n, 1:], weights, min(y * STEP, images.shape[2] - 1), costs[n, y]
            )
        _smooth(costs[n], np.empty_like(costs[n]))

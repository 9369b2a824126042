"""Kernels that find how far the nearest marked pixel is, exactly."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.threads import in_bands

__all__ = ["distances"]

# Columns, and rows, that are worth a thread of their own.
_LEAST_COLUMNS, _LEAST_ROWS = 64, 16
# Kernels count in unsigned numbers: whether a signed index is negative is asked at every element.


def distances(marked: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance in px of every pixel's centre from that of the nearest marked one (Meijster et al., 2000).

    Squared distances are integers, so that nothing is rounded but the root.

    Parameters
    ----------
    marked
        The marked pixels, at least one, shape (height, width).

    Returns
    -------
    numpy.ndarray
        Shape (height, width), float64.
    """
    height, width = marked.shape
    along = np.empty((height, width), dtype=np.int64)
    in_bands(_along_columns, width, marked, along, least=_LEAST_COLUMNS)
    out = np.empty((height, width), dtype=np.float64)
    in_bands(_across_rows, height, along, out, least=_LEAST_ROWS)
    return out


@numba.njit(cache=True, nogil=True)
def _along_columns(left: int, right: int, marked: NDArray[np.bool_], along: NDArray[np.int64]) -> None:
    """Find the nearest in the own column, down and up. Columns side by side, as they lie in memory."""
    height, width = marked.shape
    far = height + width
    for x in range(left, right):
        along[0, x] = 0 if marked[0, x] else far
    for y in range(1, height):
        for x in range(left, right):
            along[y, x] = 0 if marked[y, x] else along[y - 1, x] + 1
    for y in range(height - 2, -1, -1):
        for x in range(left, right):
            along[y, x] = min(along[y, x], along[y + 1, x] + 1)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _across_rows(low: int, high: int, along: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    width = along.shape[1]
    # The lower envelope of the parabolas (x - i)² + along[i]²: their places, and from where each is the lowest.
    place, begin = np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64)
    for y in range(np.uint64(low), np.uint64(high)):
        last = 0
        place[0], begin[0] = 0, 0
        for x in range(1, width):
            own = along[y, x] * along[y, x] + x * x
            while last >= 0:
                i, at = place[last], begin[last]
                if (at - i) ** 2 + along[y, i] ** 2 > (at - x) ** 2 + along[y, x] ** 2:
                    last -= 1
                else:
                    break
            if last < 0:
                last = 0
                place[0], begin[0] = x, 0
                continue
            i = place[last]
            # The first column at which the new one is lower.
            start = 1 + (own - along[y, i] ** 2 - i * i) // (2 * (x - i))
            if start < width:
                last += 1
                place[last], begin[last] = x, start
        for x in range(width - 1, -1, -1):
            i = place[last]
            out[y, x] = np.sqrt(float((x - i) ** 2 + along[y, i] ** 2))
            if x == begin[last]:
                last -= 1

"""Kernels for Gaussian means of maps."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_threads

__all__ = ["gaussian_mean"]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
_ROWS = 32


@_jit
def _add_multiple(out: Any, weight: Any, line: Any) -> None:
    for x in range(out.size):
        out[x] += weight * line[x]


@_jit
def _add_pair(out: Any, weight: Any, one: Any, other: Any) -> None:
    for x in range(out.size):
        out[x] += weight * (one[x] + other[x])


@_jit
def _mirrored(n: int, size: int) -> int:
    """Return an index within an array that is mirrored at its ends, which are repeated."""
    n %= 2 * size
    return n if n < size else 2 * size - 1 - n


@_jit
def _smooth_rows(values: Any, weights: Any, out: Any, rows: Any) -> None:
    height, width = values.shape
    reach = weights.size - 1
    line = np.empty(width + 2 * reach, dtype=values.dtype)
    middle = line[reach : reach + width]
    for y in range(rows[0], rows[1]):
        middle[:] = 0.0
        _add_multiple(middle, weights[0], values[y])
        for v in range(1, reach + 1):
            _add_pair(middle, weights[v], values[_mirrored(y - v, height)], values[_mirrored(y + v, height)])
        for u in range(reach):
            line[reach - 1 - u] = middle[_mirrored(-1 - u, width)]
            line[reach + width + u] = middle[_mirrored(width + u, width)]
        target = out[y]
        target[:] = 0.0
        _add_multiple(target, weights[0], middle)
        for u in range(1, reach + 1):
            _add_pair(target, weights[u], line[reach - u : reach - u + width], line[reach + u : reach + u + width])


def gaussian_mean(values: NDArray[Any], sigma_px: float, truncate: float = 4.0) -> NDArray[Any]:
    """Return the Gaussian mean around every pixel, as `scipy.ndimage.gaussian_filter`, in threads.

    ``values``: Map of float32 or float64, shape (y, x); other types are converted to float64.
    ``truncate``: Half-width of the window in standard deviations.
    """
    whole = np.ascontiguousarray(values if values.dtype.kind == "f" else values.astype(np.float64))
    reach = int(truncate * sigma_px + 0.5)
    weights = np.exp(-0.5 * (np.arange(reach + 1) / sigma_px) ** 2)
    weights = (weights / (2.0 * weights.sum() - weights[0])).astype(whole.dtype)
    out = np.empty_like(whole)
    rows = [(row, min(row + _ROWS, len(whole))) for row in range(0, len(whole), _ROWS)]
    in_threads(partial(_smooth_rows, whole, weights, out), rows)
    return out

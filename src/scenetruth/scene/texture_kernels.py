"""Kernels that look up textures on a periodic or bordered raster."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["linear_lookup", "spline_lookup"]


@numba.njit(cache=True, nogil=True, parallel=True)
def spline_lookup(coefficients: NDArray[np.float32], uv: NDArray[np.float64]) -> Any:
    """Evaluate a periodic cubic B-spline; texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h)."""
    rows, columns = coefficients.shape
    count = uv.shape[0]
    out = np.empty(count, dtype=np.float32)
    for n in numba.prange(count):
        x = uv[n, 0] * columns - 0.5
        y = uv[n, 1] * rows - 0.5
        fx, fy = np.floor(x), np.floor(y)
        x0, y0 = int(fx) - 1, int(fy) - 1
        a, b = np.float32(x - fx), np.float32(y - fy)
        a1, b1 = np.float32(1.0) - a, np.float32(1.0) - b
        wx0 = a1 * a1 * a1
        wx3 = a * a * a
        wx1 = np.float32(4.0) - np.float32(6.0) * a * a + np.float32(3.0) * wx3
        wx2 = np.float32(4.0) - np.float32(6.0) * a1 * a1 + np.float32(3.0) * wx0
        wy0 = b1 * b1 * b1
        wy3 = b * b * b
        wy1 = np.float32(4.0) - np.float32(6.0) * b * b + np.float32(3.0) * wy3
        wy2 = np.float32(4.0) - np.float32(6.0) * b1 * b1 + np.float32(3.0) * wy0
        c0, c1, c2, c3 = x0 % columns, (x0 + 1) % columns, (x0 + 2) % columns, (x0 + 3) % columns
        total = np.float32(0.0)
        for k in range(4):
            row = coefficients[(y0 + k) % rows]
            weight = wy0 if k == 0 else (wy1 if k == 1 else (wy2 if k == 2 else wy3))
            total += weight * (wx0 * row[c0] + wx1 * row[c1] + wx2 * row[c2] + wx3 * row[c3])
        out[n] = total / np.float32(36.0)
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def linear_lookup(values: NDArray[np.float32], uv: NDArray[np.float64], tiled: bool) -> Any:
    """Interpolate bilinearly; texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h), outside it repeats or stays."""
    rows, columns = values.shape
    count = uv.shape[0]
    out = np.empty(count, dtype=np.float32)
    for n in numba.prange(count):
        x = uv[n, 0] * columns - 0.5
        y = uv[n, 1] * rows - 0.5
        fx, fy = np.floor(x), np.floor(y)
        x0, y0 = int(fx), int(fy)
        x1, y1 = x0 + 1, y0 + 1
        if tiled:
            x0, x1, y0, y1 = x0 % columns, x1 % columns, y0 % rows, y1 % rows
        else:
            x0, x1 = min(max(x0, 0), columns - 1), min(max(x1, 0), columns - 1)
            y0, y1 = min(max(y0, 0), rows - 1), min(max(y1, 0), rows - 1)
        a, b = x - fx, y - fy
        upper = (1.0 - a) * values[y0, x0] + a * values[y0, x1]
        lower = (1.0 - a) * values[y1, x0] + a * values[y1, x1]
        out[n] = (1.0 - b) * upper + b * lower
    return out

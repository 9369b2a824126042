"""Kernels that tell what lies inside an outline, and that draw veins, nets and dots on a raster."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["draw_dots", "draw_veins", "inside", "net"]


@numba.njit(cache=True, nogil=True, parallel=True)
def inside(points: NDArray[np.float64], polygon: NDArray[np.float64]) -> Any:
    """Tell which points lie inside a closed polygon (even-odd rule), shape (n,) bool."""
    count, corners = points.shape[0], polygon.shape[0]
    out = np.empty(count, dtype=np.bool_)
    for n in numba.prange(count):
        x, y = points[n, 0], points[n, 1]
        odd = False
        for k in range(corners):
            y0 = polygon[k, 1]
            following = k + 1 if k + 1 < corners else 0
            y1 = polygon[following, 1]
            if (y0 > y) != (y1 > y):
                x0, x1 = polygon[k, 0], polygon[following, 0]
                if x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
                    odd = not odd
        out[n] = odd
    return out


@numba.njit(cache=True, nogil=True)
def draw_veins(
    raster: NDArray[np.float32],
    points: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    strengths: NDArray[np.float64],
) -> None:
    """Draw a polyline with a Gaussian profile into a raster, where it is larger than what is there.

    ``points``, shape (n, 2), are columns and rows; ``sigmas`` and ``strengths``, shape (n,), are those of the profile
    at the points, in texels and 1, linear in between.
    """
    rows, columns = raster.shape
    for k in range(points.shape[0] - 1):
        x0, y0 = points[k, 0], points[k, 1]
        dx, dy = points[k + 1, 0] - x0, points[k + 1, 1] - y0
        length = max(dx * dx + dy * dy, 1e-12)
        reach = 4.0 * max(sigmas[k], sigmas[k + 1])
        left = max(int(np.floor(min(x0, x0 + dx) - reach)), 0)
        right = min(int(np.ceil(max(x0, x0 + dx) + reach)), columns - 1)
        top = max(int(np.floor(min(y0, y0 + dy) - reach)), 0)
        bottom = min(int(np.ceil(max(y0, y0 + dy) + reach)), rows - 1)
        for i in range(top, bottom + 1):
            for j in range(left, right + 1):
                along = ((j - x0) * dx + (i - y0) * dy) / length
                along = min(max(along, 0.0), 1.0)
                ex, ey = j - x0 - along * dx, i - y0 - along * dy
                sigma = sigmas[k] + along * (sigmas[k + 1] - sigmas[k])
                square = (ex * ex + ey * ey) / (sigma * sigma)
                if square < 16.0:
                    value = (strengths[k] + along * (strengths[k + 1] - strengths[k])) * np.exp(-0.5 * square)
                    if value > raster[i, j]:
                        raster[i, j] = value


@numba.njit(cache=True, nogil=True)
def draw_dots(
    raster: NDArray[np.float32], points: NDArray[np.float64], sigma: float, strengths: NDArray[np.float64]
) -> None:
    """Lay Gaussian dots on a raster so that it stays below 1: v becomes 1 - (1 - v) (1 - dot)."""
    rows, columns = raster.shape
    reach = 4.5 * sigma
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        for i in range(max(int(np.ceil(y - reach)), 0), min(int(np.floor(y + reach)), rows - 1) + 1):
            for j in range(max(int(np.ceil(x - reach)), 0), min(int(np.floor(x + reach)), columns - 1) + 1):
                square = ((j - x) ** 2 + (i - y) ** 2) / (sigma * sigma)
                raster[i, j] = 1.0 - (1.0 - raster[i, j]) * (1.0 - strengths[n] * np.exp(-0.5 * square))


@numba.njit(cache=True, nogil=True, parallel=True)
def net(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    seeds: NDArray[np.float64],
    strengths: NDArray[np.float64],
    sigma: NDArray[np.float32],
) -> Any:
    """Return lines with a Gaussian profile along the borders of Voronoi cells, shape (h, w) float32.

    Parameters
    ----------
    x, y
        Where every texel is, in cells, shape (h, w); any real number, the net repeats.
    seeds
        Place of the one seed in every cell of the grid, 0 to 1, shape (n, m, 2): x, y.
    strengths
        One number for every seed, shape (n, m); a border is as strong as the mean of its two.
    sigma
        Half width of the lines in cells at every texel, shape (h, w).
    """
    rows, columns = x.shape
    high, wide = strengths.shape
    out = np.zeros((rows, columns), dtype=np.float32)
    for i in numba.prange(rows):
        for j in range(columns):
            px, py = x[i, j], y[i, j]
            column, row = int(np.floor(px)), int(np.floor(py))
            best, bx, by, bs = 1e30, 0.0, 0.0, 0.0
            for r in range(row - 2, row + 3):
                for c in range(column - 2, column + 3):
                    sx = c + seeds[r % high, c % wide, 0] - px
                    sy = r + seeds[r % high, c % wide, 1] - py
                    square = sx * sx + sy * sy
                    if square < best:
                        best, bx, by, bs = square, sx, sy, strengths[r % high, c % wide]
            value = 0.0
            width = 2.0 * sigma[i, j] * sigma[i, j]
            for r in range(row - 2, row + 3):
                for c in range(column - 2, column + 3):
                    sx = c + seeds[r % high, c % wide, 0] - px
                    sy = r + seeds[r % high, c % wide, 1] - py
                    ex, ey = sx - bx, sy - by
                    apart = ex * ex + ey * ey
                    if apart > 1e-9:
                        # Distance to the line half-way between both seeds.
                        distance = (0.5 * (sx + bx) * ex + 0.5 * (sy + by) * ey) / np.sqrt(apart)
                        line = 0.5 * (bs + strengths[r % high, c % wide]) * np.exp(-distance * distance / width)
                        value = max(value, line)
            out[i, j] = value
    return out

"""Kernels for leaves: point-in-polygon test, veins, hairs, and the network of the finest veins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["draw_dots", "draw_veins", "inside", "look_up_linearly", "net"]

_LEAST_ROWS = 2  # minimum number of rows of a network per thread


def inside(points: NDArray[np.float64], polygon: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points lie inside a closed polygon (even-odd rule), shape (n,), bool."""
    # Sorted by y, an edge overlaps a contiguous range of points.
    order = np.argsort(points[:, 1])
    x, y = points[order].T.copy()
    ends = np.stack([polygon, np.roll(polygon, -1, axis=0)])
    first, last = (np.searchsorted(y, value) for value in (ends[..., 1].min(axis=0), ends[..., 1].max(axis=0)))
    odd = np.zeros(len(order), dtype=np.bool_)
    _cross_edges(x, y, ends, first, last, odd)
    out = np.empty_like(odd)
    out[order] = odd
    return out


@kernel()
def _cross_edges(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    ends: NDArray[np.float64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    odd: NDArray[np.bool_],
) -> None:
    """Mark the points to the left of an odd number of edges, each from its first to its last point."""
    for k in range(first.size):
        x0, y0, x1, y1 = ends[0, k, 0], ends[0, k, 1], ends[1, k, 0], ends[1, k, 1]
        for n in range(first[k], last[k]):
            if x[n] < x0 + (y[n] - y0) / (y1 - y0) * (x1 - x0):
                odd[n] = not odd[n]


@kernel()
def look_up_linearly(
    fields: NDArray[np.float64],
    sizes: NDArray[np.int64],
    first: NDArray[np.int64],
    of_each: NDArray[np.int64],
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Interpolate three fields bilinearly, each point on the grid ``of_each``; outside, that of the nearest point.

    ``fields``: Values of all grids one after the other, shape (3, n), each from ``first``; ``sizes``: Rows and columns.
    """
    for k in range(rows.size):
        grid = of_each[k]
        height, width = sizes[grid, 0], sizes[grid, 1]
        y, x = min(max(rows[k], 0.0), height - 1.0), min(max(columns[k], 0.0), width - 1.0)
        i, j = int(np.floor(y)), int(np.floor(x))
        down, right = y - i, x - j
        upper, lower = first[grid] + i * width, first[grid] + min(i + 1, height - 1) * width
        after = min(j + 1, width - 1)
        for n in range(3):
            out[n][k] = (
                fields[n, upper + j] * (1 - down) * (1 - right)
                + fields[n, upper + after] * (1 - down) * right
                + fields[n, lower + j] * down * (1 - right)
                + fields[n, lower + after] * down * right
            )


@kernel()
def draw_veins(
    raster: NDArray[np.float32],
    points: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    strengths: NDArray[np.float64],
) -> None:
    """Draw a polyline with a Gaussian profile into a raster, as the maximum of both.

    Points, shape (n, 2), are columns and rows; ``sigmas`` (texels) and ``strengths``, shape (n,), are linear in
    between.
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


@kernel()
def draw_dots(
    raster: NDArray[np.float32], points: NDArray[np.float64], sigma: float, strengths: NDArray[np.float64]
) -> None:
    """Draw Gaussian dots such that the raster stays below 1: v becomes 1 - (1 - v) (1 - dot)."""
    rows, columns = raster.shape
    reach = 4.5 * sigma
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        for i in range(max(int(np.ceil(y - reach)), 0), min(int(np.floor(y + reach)), rows - 1) + 1):
            for j in range(max(int(np.ceil(x - reach)), 0), min(int(np.floor(x + reach)), columns - 1) + 1):
                square = ((j - x) ** 2 + (i - y) ** 2) / (sigma * sigma)
                raster[i, j] = 1.0 - (1.0 - raster[i, j]) * (1.0 - strengths[n] * np.exp(-0.5 * square))


def net(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    seeds: NDArray[np.float64],
    strengths: NDArray[np.float64],
    cell: tuple[float, float],
    sigma: float,
) -> NDArray[np.float32]:
    """Return lines with a Gaussian profile along the borders of Voronoi cells, shape (h, w), float32.

    ``x``, ``y``: Position of every texel, shape (h, w); the network is periodic.
    ``seeds``: Position (x, y) of the seed in every grid cell, in cells, 0 to 1, shape (n, m, 2).
    ``strengths``: Strength of every seed, shape (n, m); a border has the mean of its two seeds.
    """
    out = np.empty(x.shape, dtype=np.float32)
    in_bands(_net, x.shape[0], x, y, seeds, strengths, cell, sigma, out, least=_LEAST_ROWS)
    return out


@kernel()
def _net(
    low: int, high: int, x: NDArray[np.float32], y: NDArray[np.float32], seeds: NDArray[np.float64],
    strengths: NDArray[np.float64], cell: tuple[float, float], sigma: float, out: NDArray[np.float32],
) -> None:  # fmt: skip
    columns = x.shape[1]
    down, wide = strengths.shape
    width, height = cell
    # Seeds and strengths of the neighbouring cells whose borders may be close.
    around = 7 * 5
    seed_x, seed_y, power = np.empty(around), np.empty(around), np.empty(around)
    dx, dy, squares, sizes = np.empty(around), np.empty(around), np.empty(around), np.empty(around)
    for i in range(low, high):
        last_column, last_row, known = 0, 0, False
        for j in range(columns):
            px, py = np.float64(x[i, j]), np.float64(y[i, j])
            column, row = int(np.floor(px / width)), int(np.floor(py / height))
            # Neighbouring texels usually lie in the same cell.
            if not (known and column == last_column and row == last_row):
                last_column, last_row, known, k = column, row, True, 0
                for r in range(row - 2, row + 3):
                    for c in range(column - 3, column + 4):
                        seed_x[k] = (c + seeds[r % down, c % wide, 0]) * width
                        seed_y[k] = (r + seeds[r % down, c % wide, 1]) * height
                        power[k] = strengths[r % down, c % wide]
                        k += 1
            # Branchless loops are vectorised.
            for k in range(around):
                dx[k], dy[k] = seed_x[k] - px, seed_y[k] - py
                squares[k] = dx[k] * dx[k] + dy[k] * dy[k]
            nearest, best = 0, 1e30
            for k in range(around):
                if squares[k] < best:
                    nearest, best = k, squares[k]
            value = 0.0
            bx, by, bp = dx[nearest], dy[nearest], power[nearest]
            for k in range(around):
                ex, ey = dx[k] - bx, dy[k] - by
                # Distance to the perpendicular bisector of both seeds.
                across = 0.5 * ((dx[k] + bx) * ex + (dy[k] + by) * ey)
                squares[k], sizes[k] = across * across, (ex * ex + ey * ey) * sigma * sigma
            for k in range(around):
                # Divide only near the line, with a margin for rounding.
                if squares[k] <= 16.1 * sizes[k] and k != nearest:
                    square = squares[k] / sizes[k]
                    if square < 16.0:
                        value = max(value, 0.5 * (bp + power[k]) * np.exp(-0.5 * square))
            out[i, j] = value

"""Kernel that cuts pixels along the edges that cross them into trapezoids, and places Gauss points in each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel
from scenetruth.raycast.edge_kernels import sort_first
from scenetruth.threads import in_bands

__all__ = ["MOST_CUTS", "MOST_EDGES", "cut_pixels"]

MOST_EDGES = 12
"""Maximum number of edges in a pixel that is cut along all of them, hidden or not."""
MOST_CUTS = 32
"""Maximum number of edges in a pixel that is cut."""

_LEAST = 256  # minimum number of pixels per thread
_THIN = 1e-9  # width in px below which a cell is ignored
# At most this many lines bound slabs: the border, both ends of each edge, and the crossings of two edges.
_MOST_BOUNDS = 2 + 2 * MOST_CUTS + MOST_CUTS * (MOST_CUTS - 1) // 2


def cut_pixels(
    ends: NDArray[np.float64],
    starts: NDArray[np.int64],
    orders: NDArray[np.int64],
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Cut pixels into horizontal slabs and these into trapezoids between their edges, with Gauss points in each.

    No edge begins, ends or meets another inside a slab. The mean over a pixel is then that over smooth pieces.

    ``ends``: Ends x0, y0, x1, y1 of the edges relative to the pixel centre, in px, shape (k, 4); parts outside the
      pixel are ignored.
    ``starts``: Index of the first edge of each pixel, and the number of edges, shape (n + 1,); at most `MOST_CUTS`
      each.
    ``orders``: Gauss points per pixel along each axis, shape (n,); cells have as many as their size requires.
    ``nodes``, ``weights``: Gauss rules on [-1/2, 1/2] of the orders from 0 to the largest, shape (orders, most).
    Returns: Index of the first sample of each pixel and the number of samples, shape (n + 1,); offsets (x, y) of the
    samples in px; their weights, with sum 1 in each pixel; and the number of the trapezoid of each sample in its pixel.
    """
    count = len(orders)
    numbers = np.zeros(count + 1, dtype=np.int64)
    none = np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.int32)
    in_bands(_cut_pixels, count, ends, starts, orders, nodes, weights, numbers, *none, False, least=_LEAST)
    firsts = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(numbers[:-1])])
    out = np.empty((firsts[-1], 2)), np.empty(firsts[-1]), np.empty(firsts[-1], dtype=np.int32)
    in_bands(_cut_pixels, count, ends, starts, orders, nodes, weights, firsts, *out, True, least=_LEAST)
    return firsts, *out


@subkernel()
def _clip(ends: NDArray[np.float64], edge: int, line: NDArray[np.float64]) -> Any:
    """Write the part of an edge inside the pixel, from the upper to the lower end; return whether there is one."""
    x0, y0, x1, y1 = ends[edge, 0], ends[edge, 1], ends[edge, 2], ends[edge, 3]
    enter, leave = 0.0, 1.0
    for axis in range(2):
        start, step = (x0, x1 - x0) if axis == 0 else (y0, y1 - y0)
        if step == 0.0:
            if abs(start) > 0.5:
                return False
            continue
        one, two = (-0.5 - start) / step, (0.5 - start) / step
        enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    if not enter < leave:
        return False
    first, last = (enter, leave) if y0 <= y1 else (leave, enter)
    line[0], line[1] = x0 + first * (x1 - x0), min(max(y0 + first * (y1 - y0), -0.5), 0.5)
    line[2], line[3] = x0 + last * (x1 - x0), min(max(y0 + last * (y1 - y0), -0.5), 0.5)
    return True


@subkernel()
def _bounds(lines: NDArray[np.float64], used: int, bounds: NDArray[np.float64]) -> Any:
    """Write the heights between which no edge begins, ends or crosses another, in ascending order."""
    bounds[0], bounds[1], count = -0.5, 0.5, 2
    for n in range(used):
        bounds[count], bounds[count + 1] = lines[n, 1], lines[n, 3]
        count += 2
        slope = (lines[n, 2] - lines[n, 0]) / (lines[n, 3] - lines[n, 1])
        for m in range(n):
            other = (lines[m, 2] - lines[m, 0]) / (lines[m, 3] - lines[m, 1])
            # The height at which both lines have the same x; NaN for parallel and horizontal edges.
            at = (lines[m, 0] - other * lines[m, 1] - lines[n, 0] + slope * lines[n, 1]) / (slope - other)
            if at > max(lines[n, 1], lines[m, 1]) and at < min(lines[n, 3], lines[m, 3]):
                bounds[count] = at
                count += 1
    sort_first(bounds, count)
    return count


@kernel()
def _cut_pixels(
    low: int, high: int, ends: NDArray[np.float64], starts: NDArray[np.int64], orders: NDArray[np.int64],
    nodes: NDArray[np.float64], weights: NDArray[np.float64], firsts: NDArray[np.int64],
    offsets: NDArray[np.float64], out: NDArray[np.float64], cells: NDArray[np.int32], fill: bool,
) -> None:  # fmt: skip
    lines, bounds = np.empty((MOST_CUTS, 4), dtype=np.float64), np.empty(_MOST_BOUNDS, dtype=np.float64)
    cuts = np.empty(MOST_CUTS + 2, dtype=np.float64)
    for pixel in range(low, high):
        used = 0
        for edge in range(starts[pixel], starts[pixel + 1]):
            used += _clip(ends, edge, lines[used])
        count, order = _bounds(lines, used, bounds), orders[pixel]
        at = firsts[pixel] if fill else 0
        # Between the heights of a slab, all rows have the same parts.
        cell, parts = 0, 1
        for slab in range(count - 1):
            top, height = bounds[slab], bounds[slab + 1] - bounds[slab]
            if height <= _THIN:
                continue
            cell += parts - 1
            # Narrow cells need fewer points for the same accuracy.
            down = max(int(np.ceil(order * height)), 1)
            for row in range(down):
                y = top + height * (0.5 + nodes[down, row])
                cuts[0], cuts[1], parts = -0.5, 0.5, 2
                for n in range(used):
                    if lines[n, 1] < y < lines[n, 3]:
                        share = (y - lines[n, 1]) / (lines[n, 3] - lines[n, 1])
                        cuts[parts] = min(max(lines[n, 0] + share * (lines[n, 2] - lines[n, 0]), -0.5), 0.5)
                        parts += 1
                sort_first(cuts, parts)
                for part in range(parts - 1):
                    width = cuts[part + 1] - cuts[part]
                    if width <= _THIN:
                        continue
                    across = max(int(np.ceil(order * width)), 1)
                    for column in range(across):
                        if fill:
                            offsets[at, 0] = cuts[part] + width * (0.5 + nodes[across, column])
                            offsets[at, 1] = y
                            out[at] = height * weights[down, row] * width * weights[across, column]
                            cells[at] = cell + part
                        at += 1
        if not fill:
            firsts[pixel] = at

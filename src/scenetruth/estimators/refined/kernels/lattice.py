"""Kernels that interpolate the fits of a lattice of windows at all pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.window_solver import CURVED, FULL
from scenetruth.kernels import kernel

__all__ = ["STENCIL", "carry_rows", "find_smooth_cells", "interpolate_rows"]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

STENCIL = 4
"""Number of nodes along each axis from which a value between them is interpolated."""


@_jit
def find_smooth_cells(rough: NDArray[np.bool_], models: NDArray[np.int8], out: NDArray[np.bool_]) -> None:
    """Mark the cells between four nodes whose values can be interpolated.

    None of these nodes is rough, and all nodes of the stencil have one model and a fit.

    ``rough``: Nodes at which the fit varies too much, shape (rows, columns).
    ``models``: Models of the nodes, -128 for those without a fit, of the same shape.
    ``out``: Output, shape (rows, columns): the cell below and to the right of each node.
    """
    height, width = rough.shape
    out[:] = False
    if height < STENCIL or width < STENCIL:
        return
    for y in range(height - 1):
        top = min(max(y - 1, 0), height - STENCIL)
        for x in range(width - 1):
            left = min(max(x - 1, 0), width - STENCIL)
            smooth = not (rough[y, x] or rough[y, x + 1] or rough[y + 1, x] or rough[y + 1, x + 1])
            for v in range(top, top + STENCIL):
                for u in range(left, left + STENCIL):
                    smooth = smooth and models[v, u] != -128 and models[v, u] == models[y, x]
            out[y, x] = smooth


@_jit
def _cubic(at: float, w: Any) -> None:
    """Write the weights of four nodes at 0, 1, 2 and 3 of the cubic polynomial through their values."""
    w[0] = (at - 1.0) * (at - 2.0) * (at - 3.0) / -6.0
    w[1] = at * (at - 2.0) * (at - 3.0) / 2.0
    w[2] = at * (at - 1.0) * (at - 3.0) / -2.0
    w[3] = at * (at - 1.0) * (at - 2.0) / 6.0


@_jit
def interpolate_rows(
    nodes: Any,
    step: int,
    smooth: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    positive: bool,
    signed: int,
    out: Any,
    rows: Any,
) -> None:
    """Interpolate maps of nodes by cubic polynomials along both axes, in smooth cells.

    ``nodes``: Maps of the nodes, shape (maps, rows, columns).
    ``smooth``: Cells of `find_smooth_cells`.
    ``wanted``: Pixels of the image, shape (height, width).
    ``positive``: Whether all values are positive: then they are at least the smallest of the nodes of their cell.
    ``signed``: Number of the first map of a direction of arbitrary sign, which is of three maps; -1 for none.
    ``out``: Output where wanted and smooth, shape (maps, height, width).
    """
    count, down, across = nodes.shape
    width = wanted.shape[1]
    if down < STENCIL or across < STENCIL:
        return
    w, line, sign = np.empty(STENCIL), np.empty((count, across)), np.ones((STENCIL, across))
    weights = np.empty((step, 3, STENCIL))
    # Stencils at the left end, in the middle, and at the right end.
    for x in range(step):
        for place in range(3):
            _cubic(x / step + place, weights[x, place])
    for y in range(rows[0], rows[1]):
        cell = y // step
        if cell >= down - 1 or not smooth[cell].any():
            continue
        top = min(max(cell - 1, 0), down - STENCIL)
        _cubic(y / step - top, w)
        for n in range(count):
            if signed >= 0 and n == signed:
                for v in range(STENCIL):
                    for u in range(across):
                        total = 0.0
                        for k in range(3):
                            total += nodes[n + k, top + v, u] * nodes[n + k, cell, u]
                        sign[v, u] = -1.0 if total < 0.0 else 1.0
            by_sign = signed >= 0 and signed <= n < signed + 3
            for u in range(across):
                total = 0.0
                for v in range(STENCIL):
                    total += (w[v] * sign[v, u] if by_sign else w[v]) * nodes[n, top + v, u]
                line[n, u] = total
        for x in range(width):
            beside = x // step
            if beside >= across - 1 or not (wanted[y, x] and smooth[cell, beside]):
                continue
            left = min(max(beside - 1, 0), across - STENCIL)
            of = weights[x - beside * step, beside - left]
            for n in range(count):
                if signed >= 0 and signed <= n < signed + 3:
                    continue
                total = 0.0
                for u in range(STENCIL):
                    total += of[u] * line[n, left + u]
                if positive:
                    above = min(nodes[n, cell, beside], nodes[n, cell, beside + 1])
                    below = min(nodes[n, cell + 1, beside], nodes[n, cell + 1, beside + 1])
                    total = max(total, min(above, below))
                out[n, y, x] = total
            if signed >= 0:
                for k in range(3):
                    out[signed + k, y, x] = 0.0
                for u in range(STENCIL):
                    total = 0.0
                    for k in range(3):
                        total += line[signed + k, left + u] * line[signed + k, beside]
                    turned = -of[u] if total < 0.0 else of[u]
                    for k in range(3):
                        out[signed + k, y, x] += turned * line[signed + k, left + u]


@_jit
def carry_rows(
    nodes: Any, step: int, cells: NDArray[np.bool_], wanted: NDArray[np.bool_], models: bool, out: Any, rows: Any
) -> None:
    """Write the values of the nearest node in a set of cells.

    ``cells``: The cell below and to the right of each node, shape (rows, columns).

    ``models``: Whether the maps are parameters of a fit, which are converted to the pixel as its centre.
    """
    count, down, across = nodes.shape
    width = wanted.shape[1]
    for y in range(rows[0], rows[1]):
        row, cell = min((y + step // 2) // step, down - 1), min(y // step, down - 1)
        for x in range(width):
            if not (wanted[y, x] and cells[cell, min(x // step, across - 1)]):
                continue
            column = min((x + step // 2) // step, across - 1)
            for n in range(count):
                out[n, y, x] = nodes[n, row, column]
            if models:
                u, v = float(x - column * step), float(y - row * step)
                d_xx, d_xy, d_yy = out[3, y, x], out[4, y, x], out[5, y, x]
                out[0, y, x] += out[1, y, x] * u + out[2, y, x] * v + d_xx * u * u + d_xy * u * v + d_yy * v * v
                out[1, y, x] += 2.0 * d_xx * u + d_xy * v
                out[2, y, x] += d_xy * u + 2.0 * d_yy * v
                for k in range(CURVED, FULL, 3):
                    out[k, y, x] += out[k + 1, y, x] * u + out[k + 2, y, x] * v

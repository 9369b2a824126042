"""Kernels that compare the fit of every pixel with the model of a neighbour, converted to the pixel.

The displacement of a point between two models is the largest over all images: the change of each field times its arm,
see `ImageStack.arms`. Only the fields at the pixel are converted, which are sums over few of the parameters.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import STEADY
from scenetruth.estimators.refined.kernels.window_solver import CURVED, FULL
from scenetruth.kernels import kernel

__all__ = ["find_jumps", "mark_extended"]


# Reassociation and contraction only: NaN must stay NaN.
_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@_jit
def _displace(theta: Any, arms: Any, row: int, right: int, down: int, moved: Any, beside: Any) -> None:
    """Write the displacement between each pixel's model and its neighbour's, and the disparity of the latter.

    ``row``: Row of the pixels; their neighbours are at an offset of ``-right`` columns and ``-down`` rows.
    ``moved``, ``beside``: Output for the pixels with a neighbour, by their columns; NaN for the others.
    """
    height, width = theta.shape[1:]
    moved[:], beside[:] = np.nan, np.nan
    first, last, other = max(right, 0), width + min(right, 0), row - down
    if other < 0 or other >= height or first >= last:
        return
    x, y = float(right), float(down)
    out, d = moved[first:last], theta[0, row, first:last]
    near = theta[:, other, first - right : last - right]
    of_neighbour = beside[first:last]
    for n in range(out.size):
        second = near[3, n] * x * x + near[4, n] * x * y + near[5, n] * y * y
        of_neighbour[n] = near[0, n] + near[1, n] * x + near[2, n] * y + second
    for n in range(out.size):
        out[n] = abs(of_neighbour[n] - d[n]) * arms[0]
    for field in range(1, len(arms)):
        arm = arms[field]
        if field < STEADY:
            place = CURVED + 3 * (field - 1)
            value, along, across, own = near[place], near[place + 1], near[place + 2], theta[place, row, first:last]
            for n in range(out.size):
                change = abs(value[n] + along[n] * x + across[n] * y - own[n]) * abs(d[n]) * arm
                # Not the smaller of both, and not a number if either is not.
                out[n] = out[n] if out[n] > change or np.isnan(out[n]) else change
        else:
            place = FULL + field - STEADY
            value, own = near[place], theta[place, row, first:last]
            for n in range(out.size):
                change = abs(value[n] - own[n]) * abs(d[n]) * arm
                out[n] = out[n] if out[n] > change or np.isnan(out[n]) else change


@_jit
def find_jumps(
    theta: NDArray[np.float64],
    arms: NDArray[np.float64],
    offset: tuple[int, int],
    limit: float,
    found: NDArray[np.bool_],
    rows: tuple[int, int],
) -> None:
    """Mark the pixels whose neighbour is invalid, or has a model that displaces them by more than a limit.

    ``theta``: Parameters of the fits, shape (15 or 18, y, x), NaN where invalid.
    ``arms``: Displacement in px by a unit of disparity, and by one of velocity at a disparity of 1, shape (4 or 7,).
    ``offset``: Columns and rows from the neighbour to the pixel; pixels without a neighbour are not marked.
    ``limit``: Displacement in px.
    ``found``: Set where marked, shape (y, x).
    """
    right, down = offset
    height, width = found.shape
    moved, beside = np.empty(width), np.empty(width)
    first, last = max(right, 0), width + min(right, 0)
    for y in range(rows[0], rows[1]):
        if not 0 <= y - down < height:
            continue
        _displace(theta, arms, y, right, down, moved, beside)
        for x in range(first, last):
            if not moved[x] <= limit:
                found[y, x] = True


@_jit
def mark_extended(
    theta: NDArray[np.float64],
    arms: NDArray[np.float64],
    offset: tuple[int, int],
    limit: float,
    gradient: NDArray[np.floating[Any]],
    dominant: float,
    found: NDArray[np.bool_],
    rows: tuple[int, int],
) -> None:
    """Mark the pixels of a surface that images extend over that of a neighbour: of the nearer, or of stronger texture.

    ``theta``, ``arms``, ``offset``, ``limit``, ``found``: As for `find_jumps`; invalid neighbours are not compared.
    ``gradient``: Mean square texture gradient, shape (y, x), compared with that at twice the offset, cyclic at the ends
      of the image; shape (0, 0) to compare disparities only.
    ``dominant``: Ratio of the gradients from which one texture dominates.
    """
    right, down = offset
    height, width = found.shape
    moved, beside = np.empty(width), np.empty(width)
    for y in range(rows[0], rows[1]):
        _displace(theta, arms, y, right, down, moved, beside)
        far = (y - 2 * down) % height
        for x in range(width):
            if not moved[x] > limit:
                continue
            extended = abs(theta[0, y, x]) > abs(beside[x])
            if not extended and gradient.shape[0] > 0:
                extended = gradient[y, x] > dominant * gradient[far, (x - 2 * right) % width]
            if extended:
                found[y, x] = True

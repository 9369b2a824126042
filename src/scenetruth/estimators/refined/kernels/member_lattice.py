"""Kernel that interpolates fits to the pixels of one surface between every other row and column."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import STEADY
from scenetruth.estimators.refined.kernels.window_solver import CURVED, DIRECTION, FULL, Fit
from scenetruth.kernels import kernel

__all__ = ["interpolate_members", "is_node"]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

# Relative positions of the nodes of a pixel in an odd column, in an odd row, and in both.
_BESIDE = np.array([[[0, -1], [0, 1], [0, -1], [0, 1]], [[-1, 0], [1, 0], [-1, 0], [1, 0]]])
_DIAGONAL = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])


def is_node(pixels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which pixels, as rows and columns of shape (n, 2), are in an even row and an even column."""
    return np.asarray((pixels % 2 == 0).all(axis=1))


@_jit
def _carry(theta: Any, number: int, x: float, y: float, out: Any) -> None:
    """Write the parameters relative to a point at a distance from the pixel."""
    for k in range(len(theta)):
        out[k] = theta[k, 0, number]
    d_xx, d_xy, d_yy = out[3], out[4], out[5]
    out[0] += out[1] * x + out[2] * y + d_xx * x * x + d_xy * x * y + d_yy * y * y
    out[1] += 2.0 * d_xx * x + d_xy * y
    out[2] += d_xy * x + 2.0 * d_yy * y
    for k in range(CURVED, FULL, 3):
        out[k] += out[k + 1] * x + out[k + 2] * y


@_jit
def _moved_px(one: Any, other: Any, arms: Any) -> Any:
    """Return the largest displacement over all images by the difference of two sets of parameters."""
    moved = abs(one[0] - other[0]) * arms[0]
    for k in range(1, arms.size):
        place = CURVED + 3 * (k - 1) if k < STEADY else FULL + k - STEADY
        moved = max(moved, abs(one[place] - other[place]) * abs(other[0]) * arms[k])
    return moved


@_jit
def _average(maps: Any, numbers: Any, count: int, number: int) -> None:
    """Write the mean of the entries of a map of a single row."""
    for k in range(len(maps)):
        total = 0.0
        for n in range(count):
            total += maps[k, 0, numbers[n]]
        maps[k, 0, number] = total / count


@_jit
def interpolate_members(
    pixels: NDArray[np.int64],
    index: NDArray[np.int32],
    fitted: NDArray[np.bool_],
    begun: NDArray[np.float64],
    fit: Fit,
    shares: NDArray[np.float64],
    arms: NDArray[np.float64],
    limits: tuple[float, float],
    left: NDArray[np.bool_],
    part: tuple[int, int],
) -> None:
    """Write the mean fit of the adjacent nodes where these belong to the surface of a pixel and agree.

    ``pixels``, ``fit``, ``shares``: As in `window_sums.solve_members`.
    ``index``: Number of the pixel at each row and column of the image, -1 where there is none.
    ``fitted``: Nodes with a fit, shape (n,).
    ``begun``: Parameters before the fit, shape (15 or 18, 1, n).
    ``arms``: Displacement in px by a unit of disparity, and by a unit of velocity and acceleration per px of disparity.
    ``limits``: Largest displacement by the difference of initial parameters, and of fits, in px.
    ``left``: Pixels to be interpolated; set to False where done.
    """
    height, width = index.shape
    numbers, count = np.empty(4, dtype=np.int64), 0
    own, other, mean = np.empty(len(begun)), np.empty(len(begun)), np.empty(len(begun))
    several = fit.variance.shape[2] == len(pixels)
    for number in range(part[0], part[1]):
        if not left[number]:
            continue
        y, x = pixels[number]
        odd_row, odd_column = y % 2 == 1, x % 2 == 1
        count = 4 if odd_row and odd_column else 2
        agree = True
        for k in range(len(own)):
            own[k], mean[k] = begun[k, 0, number], 0.0
        for n in range(count):
            down, right = _DIAGONAL[n] if count == 4 else _BESIDE[1 if odd_row else 0, n]
            v, u = y + down, x + right
            agree = agree and v >= 0 and v < height and u >= 0 and u < width
            if not agree:
                break
            numbers[n] = index[v, u]
            agree = numbers[n] >= 0 and fitted[numbers[n]]
            if not agree:
                break
            _carry(begun, numbers[n], -right, -down, other)
            agree = _moved_px(other, own, arms) < limits[0]
            if not agree:
                break
            _carry(fit.theta, numbers[n], -right, -down, other)
            for k in range(len(mean)):
                mean[k] += other[k] / count
        if not agree:
            continue
        for n in range(count):
            down, right = _DIAGONAL[n] if count == 4 else _BESIDE[1 if odd_row else 0, n]
            _carry(fit.theta, numbers[n], -right, -down, other)
            agree = agree and _moved_px(other, mean, arms) < limits[1]
        if not agree:
            continue
        for k in range(len(mean)):
            fit.theta[k, 0, number] = mean[k]
        _average(fit.residual, numbers, count, number)
        for k in range(2):
            total = 0.0
            for n in range(count):
                total += shares[numbers[n], k]
            shares[number, k] = total / count
        left[number] = False
        if not several:
            continue
        _average(fit.variance, numbers, count, number)
        _average(fit.element, numbers, count, number)
        _average(fit.element_variance, numbers, count, number)
        total = 0.0
        for n in range(count):
            total += fit.images[0, numbers[n]]
        fit.images[0, number] = total / count
        # The sign of a direction is arbitrary.
        for k in range(DIRECTION, DIRECTION + 3):
            fit.element[k, 0, number] = 0.0
        for n in range(count):
            along = np.float32(0.0)
            for k in range(DIRECTION, DIRECTION + 3):
                along += fit.element[k, 0, numbers[n]] * fit.element[k, 0, numbers[0]]
            sign = np.float32(-1.0) if along < 0.0 else np.float32(1.0)
            for k in range(DIRECTION, DIRECTION + 3):
                fit.element[k, 0, number] += sign * fit.element[k, 0, numbers[n]] / np.float32(count)

"""Kernels of the second-order Taylor arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["compose", "multiply", "rotate"]

_BLOCK = 256  # block size such that all rows of both factors and of the product fit into the cache
_LEAST = 65536  # minimum number of coefficients per thread


def multiply(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply the coefficients of two jets, shape (rows, n) each; n = 1 is broadcast."""
    out = np.empty((x.shape[0], max(x.shape[1], y.shape[1])))
    variables = {3: 1, 6: 2, 10: 3}[x.shape[0]]
    _in_bands(_multiply, x, y, variables, out)
    return out


@kernel()
def _multiply(begin: int, end: int, x: Any, y: Any, variables: int, out: Any) -> None:
    step_x, step_y = int(x.shape[1] > 1), int(y.shape[1] > 1)
    for low in range(begin, end, _BLOCK):
        high = min(low + _BLOCK, end)
        for n in range(low, high):
            out[0, n] = x[0, n * step_x] * y[0, n * step_y]
        row = 1 + variables
        for i in range(variables):
            for n in range(low, high):
                out[1 + i, n] = x[0, n * step_x] * y[1 + i, n * step_y] + x[1 + i, n * step_x] * y[0, n * step_y]
            for j in range(i, variables):
                for n in range(low, high):
                    outer = x[1 + i, n * step_x] * y[1 + j, n * step_y] + x[1 + j, n * step_x] * y[1 + i, n * step_y]
                    inner = x[0, n * step_x] * y[row, n * step_y] + x[row, n * step_x] * y[0, n * step_y]
                    out[row, n] = inner + outer
                row += 1


def compose(
    x: NDArray[np.float64], value: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Apply a function, given by its value and derivatives of shape (n,), to the coefficients of a jet."""
    out = np.empty((x.shape[0], max(x.shape[1], value.shape[0])))
    variables = {3: 1, 6: 2, 10: 3}[x.shape[0]]
    parts = np.asarray(value), np.asarray(first), np.asarray(second)
    _in_bands(_compose, x, *parts, variables, out)
    return out


@kernel()
def _compose(begin: int, end: int, x: Any, value: Any, first: Any, second: Any, variables: int, out: Any) -> None:
    step_x, step = int(x.shape[1] > 1), int(value.shape[0] > 1)
    for low in range(begin, end, _BLOCK):
        high = min(low + _BLOCK, end)
        for n in range(low, high):
            out[0, n] = value[n * step]
        row = 1 + variables
        for i in range(variables):
            for n in range(low, high):
                out[1 + i, n] = first[n * step] * x[1 + i, n * step_x]
            for j in range(i, variables):
                for n in range(low, high):
                    outer = second[n * step] * x[1 + i, n * step_x] * x[1 + j, n * step_x]
                    out[row, n] = first[n * step] * x[row, n * step_x] + outer
                row += 1


def rotate(
    points: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    axis: tuple[float, float, float],
    sine: float,
    cosine: float,
    centre: tuple[float, float, float],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rotate points by a constant angle about an axis, a unit vector: as by arithmetic with jets, to the last bit.

    ``points``: Coefficients of X, Y and Z, shape (rows, n) each.
    """
    shape = points[0].shape
    out = np.empty(shape), np.empty(shape), np.empty(shape)
    _rotate(points, axis, sine, cosine, centre, out)
    return out


@kernel()
def _rotate(points: Any, axis: Any, sine: float, cosine: float, centre: Any, out: Any) -> None:
    rows, count = points[0].shape
    nx, ny, nz = axis
    rest = 1.0 - cosine
    for row in range(rows):
        # Only values have a centre. Minus zero changes no number.
        ax, ay, az = (-centre[0], -centre[1], -centre[2]) if row == 0 else (-0.0, -0.0, -0.0)
        cx, cy, cz = centre if row == 0 else (-0.0, -0.0, -0.0)
        for n in range(count):
            x, y, z = points[0][row, n] + ax, points[1][row, n] + ay, points[2][row, n] + az
            along = (nx * x + ny * y + nz * z) * rest
            out[0][row, n] = x * cosine + (ny * z - nz * y) * sine + nx * along + cx
            out[1][row, n] = y * cosine + (nz * x - nx * z) * sine + ny * along + cy
            out[2][row, n] = z * cosine + (nx * y - ny * x) * sine + nz * along + cz


def _in_bands(kernel: Callable[..., None], *arguments: Any) -> None:
    rows, count = arguments[-1].shape
    # For small jets, the query of the thread count would take longer than the work.
    if count * rows < 2 * _LEAST:
        kernel(0, count, *arguments)
    else:
        in_bands(kernel, count, *arguments, least=_LEAST // rows)

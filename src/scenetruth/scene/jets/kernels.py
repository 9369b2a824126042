"""Kernels of the second-order Taylor arithmetic."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["compose", "multiply"]

# Values in a block: all rows of both factors and of the product stay in the cache.
_BLOCK = 256
# Up to so many values, starting threads takes longer than the work.
_FEW = 8192


def multiply(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply two jets' coefficients, shape (rows, n) each; n = 1 stands for any number."""
    out = np.empty((x.shape[0], max(x.shape[1], y.shape[1])))
    variables = {3: 1, 6: 2, 10: 3}[x.shape[0]]
    if out.shape[1] <= _FEW:
        _multiply_block(x, y, variables, out, 0, out.shape[1])
    else:
        _multiply(x, y, variables, out)
    return out


def compose(
    x: NDArray[np.float64], value: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Apply a function, given by its value and derivatives of shape (n,), to a jet's coefficients."""
    out = np.empty((x.shape[0], max(x.shape[1], value.shape[0])))
    variables = {3: 1, 6: 2, 10: 3}[x.shape[0]]
    parts = np.asarray(value), np.asarray(first), np.asarray(second)
    if out.shape[1] <= _FEW:
        _compose_block(x, *parts, variables, out, 0, out.shape[1])
    else:
        _compose(x, *parts, variables, out)
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def _multiply(x: Any, y: Any, variables: int, out: Any) -> None:
    count = out.shape[1]
    for block in numba.prange((count + _BLOCK - 1) // _BLOCK):
        _multiply_block(x, y, variables, out, block * _BLOCK, min((block + 1) * _BLOCK, count))


@numba.njit(cache=True, nogil=True)
def _multiply_block(x: Any, y: Any, variables: int, out: Any, low: int, high: int) -> None:
    step_x, step_y = int(x.shape[1] > 1), int(y.shape[1] > 1)
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


@numba.njit(cache=True, nogil=True, parallel=True)
def _compose(x: Any, value: Any, first: Any, second: Any, variables: int, out: Any) -> None:
    count = out.shape[1]
    for block in numba.prange((count + _BLOCK - 1) // _BLOCK):
        high = min((block + 1) * _BLOCK, count)
        _compose_block(x, value, first, second, variables, out, block * _BLOCK, high)


@numba.njit(cache=True, nogil=True)
def _compose_block(x: Any, value: Any, first: Any, second: Any, variables: int, out: Any, low: int, high: int) -> None:
    step_x, step = int(x.shape[1] > 1), int(value.shape[0] > 1)
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

"""Kernel that sums up the energies of an image's gradients, filtered once and twice, in small blocks."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["ENERGIES", "gradient_energies"]

# Places of the energies: of g_x and g_y, of both smoothed with S, and of D_x S_y g_x and D_y S_x g_y.
_X, _Y, _SMOOTH_X, _SMOOTH_Y, _STEEP_X, _STEEP_Y = range(6)

ENERGIES = ("x", "y", "sx", "sy", "dx", "dy")
"""Names of the energies in the order of their places."""

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _along_rows(source: Any, kernel: Any, out: Any) -> None:
    """Correlate every row with a kernel."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            total = np.float32(0.0)
            for k in range(kernel.shape[0]):
                total += kernel[k] * source[y, x + k]
            out[y, x] = total


@_jit
def _along_columns(source: Any, kernel: Any, out: Any) -> None:
    """Correlate every column with a kernel."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = 0.0
        for k in range(kernel.shape[0]):
            weight, row = kernel[k], source[y + k]
            for x in range(out.shape[1]):
                out[y, x] += weight * row[x]


@_jit
def _add_energy(values: Any, margin: int, stride: int, out: Any) -> None:
    for y in range(margin, values.shape[0] - margin):
        for x in range(margin, values.shape[1] - margin):
            out[(x - margin) // stride] += values[y, x] * values[y, x]


@_jit
def gradient_energies(
    image: NDArray[np.float32],
    smoothing: NDArray[np.float32],
    derivative: NDArray[np.float32],
    stride: int,
    energies: NDArray[np.float32],
    blocks: tuple[int, int],
) -> None:
    """Add up g_x², g_y², (S g_x)², (S g_y)², (D_x S_y g_x)² and (D_y S_x g_y)² in blocks.

    Parameters
    ----------
    image
        The image with twice the filters' reach of border, shape (y, x).
    smoothing, derivative
        S and D as correlation kernels, of odd length.
    stride
        Edge of the blocks in px.
    energies
        Output in the order of `ENERGIES`, added to, shape (6, Y, X): Y x X blocks of the image without its border.
    blocks
        First and last + 1 of the rows of blocks to do.
    """
    taps = smoothing.shape[0]
    reach = taps // 2
    width = image.shape[1] - 4 * reach
    for block in range(blocks[0], blocks[1]):
        first = block * stride
        rows = min(stride, image.shape[0] - 4 * reach - first)
        part = image[first : first + rows + 4 * reach]
        tall, wide = rows + 2 * reach, width + 2 * reach
        smooth = np.empty((tall, part.shape[1]), dtype=np.float32)
        steep = np.empty((tall, part.shape[1]), dtype=np.float32)
        g_x = np.empty((tall, wide), dtype=np.float32)
        g_y = np.empty((tall, wide), dtype=np.float32)
        _along_columns(part, smoothing, smooth)
        _along_columns(part, derivative, steep)
        _along_rows(smooth, derivative, g_x)
        _along_rows(steep, smoothing, g_y)
        _add_energy(g_x, reach, stride, energies[_X, block])
        _add_energy(g_y, reach, stride, energies[_Y, block])
        once = np.empty((rows, wide), dtype=np.float32)
        twice = np.empty((rows, width), dtype=np.float32)
        _along_columns(g_x, smoothing, once)
        _along_rows(once, smoothing, twice)
        _add_energy(twice, 0, stride, energies[_SMOOTH_X, block])
        _along_rows(once, derivative, twice)
        _add_energy(twice, 0, stride, energies[_STEEP_X, block])
        _along_columns(g_y, smoothing, once)
        _along_rows(once, smoothing, twice)
        _add_energy(twice, 0, stride, energies[_SMOOTH_Y, block])
        _along_columns(g_y, derivative, once)
        _along_rows(once, smoothing, twice)
        _add_energy(twice, 0, stride, energies[_STEEP_Y, block])

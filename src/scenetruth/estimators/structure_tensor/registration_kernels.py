"""Kernels over whole images: matching costs of neighbouring cameras at integer disparities, and gradient energies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel

__all__ = ["ENERGIES", "STEP", "gradient_energies", "matching_costs"]


STEP = 4
"""Distance of the grid points at which images are compared, in px."""

UNSEEN = np.float32(1e30)
"""Cost where no two neighbouring cameras view a point: larger than any image difference."""

# Half the side length of the square over which differences are summed, in grid points of STEP px.
_HALF = 2

_jit = kernel(error_model="numpy")


@_jit
def _row_costs(images: Any, first: Any, second: Any, weights: Any, y: int, out: Any) -> None:
    """Sum the squared image differences of neighbouring cameras over blocks of STEP pixels, where both have a view.

    Invalid pixels (NaN) are not in view.
    """
    width = images.shape[3]
    compared = np.zeros(out.shape[0], dtype=np.float32)
    wanted = np.zeros(out.shape[0], dtype=np.float32)
    out[:] = 0.0
    for channel in range(images.shape[0]):
        for s in range(images.shape[1] - 1):
            a, b = images[channel, s, y], images[channel, s + 1, y]
            for block in range(out.shape[0]):
                start, end = block * STEP, min((block + 1) * STEP, width)
                low = max(start, -first[s], -second[s])
                high = min(end, width - first[s], width - second[s])
                total = np.float32(0.0)
                for x in range(low, high):
                    difference = a[x + first[s]] - b[x + second[s]]
                    total += difference * difference
                pixels = max(high - low, 0)
                if total != total:
                    total, pixels = np.float32(0.0), 0
                    for x in range(low, high):
                        difference = a[x + first[s]] - b[x + second[s]]
                        if difference == difference:
                            total += difference * difference
                            pixels += 1
                out[block] += total * weights[s]
                compared[block] += pixels * weights[s]
                wanted[block] += (end - start) * weights[s]
    for block in range(out.shape[0]):
        # Pixels outside the view of a camera are compared by the others: the sum is scaled to all cameras.
        out[block] = out[block] * wanted[block] / compared[block] if compared[block] > 0 else UNSEEN


@_jit
def _smooth(costs: Any, scratch: Any) -> None:
    """Sum costs over a square, in place, with the border values repeated outside the image."""
    rows, columns = costs.shape
    for y in range(rows):
        for x in range(columns):
            total = np.float32(0.0)
            for k in range(-_HALF, _HALF + 1):
                total += costs[y, min(max(x + k, 0), columns - 1)]
            scratch[y, x] = total
    for y in range(rows):
        for x in range(columns):
            costs[y, x] = 0.0
        for k in range(-_HALF, _HALF + 1):
            source = scratch[min(max(y + k, 0), rows - 1)]
            for x in range(columns):
                costs[y, x] += source[x]


@_jit
def matching_costs(
    images: NDArray[np.float32],
    offsets: NDArray[np.int64],
    weights: NDArray[np.float32],
    costs: NDArray[np.float32],
    some: tuple[int, int],
) -> None:
    """Sum the squared image differences of neighbouring cameras around every grid point.

    ``images``: Images of one frame, shape (channel, s, y, x).
    ``offsets``: Column offset at which each image is read, for every registration; shape (n, s).
    ``weights``: Weight of each pair of neighbouring cameras, shape (s - 1,).
    ``costs``: Output, shape (n, y / STEP, x / STEP), rounded up; `UNSEEN` or more where no pair views a point.
    """
    for n in range(some[0], some[1]):
        for y in range(costs.shape[1]):
            _row_costs(
                images, offsets[n, :-1], offsets[n, 1:], weights, min(y * STEP, images.shape[2] - 1), costs[n, y]
            )
        _smooth(costs[n], np.empty_like(costs[n]))


# Indices of the energies: of g_x and g_y, of both smoothed with S, and of D_x S_y g_x and D_y S_x g_y.
_X, _Y, _SMOOTH_X, _SMOOTH_Y, _STEEP_X, _STEEP_Y = range(6)

ENERGIES = ("x", "y", "sx", "sy", "dx", "dy")
"""Names of the energies in the order of their indices."""


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
    """Add g_x², g_y², (S g_x)², (S g_y)², (D_x S_y g_x)² and (D_y S_x g_y)² in blocks.

    ``image``: The image with a border of twice the filter half-width, shape (y, x).
    ``stride``: Side length of the blocks in px.
    ``energies``: Output in the order of `ENERGIES`, incremented, shape (6, Y, X): Y x X blocks of the image without
      border.
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

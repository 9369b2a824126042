"""Kernels that compare the warped images: agreement at every pixel, occlusion, and shifts of blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.spline_samples import sample_cubic, sample_quintic
from scenetruth.estimators.refined.kernels.warp import (
    ACCELERATED,
    CUBIC,
    QUINTIC,
    STEADY,
    ImageView,
    corrected,
    find_columns,
    find_offsets,
    image_parts,
    mean_of_row,
    place_columns,
    place_of,
)

__all__ = ["SIDES", "SUMS", "add_shifts", "hide", "judge_rows"]


_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

SUMS = 7
"""Number of sums that `add_shifts` fills."""


@_jit
def add_shifts(
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    least: int,
    first_row: int,
    block: int,
    sums: NDArray[np.float64],
    rows: tuple[int, int],
) -> None:
    """Sum the normal equations of the shift between each image and the mean image T over blocks of pixels.

    The shift δ of an image with grey value g minimises Σ (g + ∇T · δ - T)²: Σ ∇T ∇Tᵀ δ = Σ ∇T (T - g).

    ``block``: Side length of a block in px; blocks begin at row and column 0 of the image.
    ``sums``: Incremented: for every row of blocks, block and image the sums of T_x², T_x T_y, T_y², T_x (T - g), T_y (T
      - g), (T - g)² and 1, shape (rows of blocks, columns of blocks, n, 7).
    """
    count, height, width = warped.shape
    mean = np.empty(width)
    for down in range(rows[0], rows[1]):
        for row in range(max(down * block - first_row, 0), min((down + 1) * block - first_row, height)):
            mean_of_row(warped, row, least, mean)
            for i in range(count):
                for x in range(width):
                    g = warped[i, row, x]
                    if np.isnan(g) or np.isnan(mean[x]):
                        continue
                    along, below, left = gradient[0, row, x], gradient[1, row, x], mean[x] - g
                    out = sums[down, x // block, i]
                    out[0] += along * along
                    out[1] += along * below
                    out[2] += below * below
                    out[3] += along * left
                    out[4] += below * left
                    out[5] += left * left
                    out[6] += 1.0


SIDES = 7
"""All images; those with s ≤ 0, s ≥ 0, t ≤ 0, t ≥ 0, s_y ≤ 0, s_y ≥ 0: occlusion affects one side only."""
# Smallest number of images for a variance.
_LEAST = 3


@_jit
def _normalised(value: Any, gain: Any, offset: Any, block: Any, y: Any, x: Any) -> Any:
    """Return a grey value without gain and offset, which are interpolated between the centres of blocks."""
    down, across = gain.shape
    row = min(max((y + 0.5) / block - 0.5, 0.0), down - 1.0)
    column = min(max((x + 0.5) / block - 0.5, 0.0), across - 1.0)
    above, beside = int(row), int(column)
    below, right = min(above + 1, down - 1), min(beside + 1, across - 1)
    v1, u1 = np.float32(row - above), np.float32(column - beside)
    v0, u0 = np.float32(1.0) - v1, np.float32(1.0) - u1
    scaled = v0 * (u0 * gain[above, beside] + u1 * gain[above, right])
    scaled += v1 * (u0 * gain[below, beside] + u1 * gain[below, right])
    shifted = v0 * (u0 * offset[above, beside] + u1 * offset[above, right])
    shifted += v1 * (u0 * offset[below, beside] + u1 * offset[below, right])
    return (value - shifted) / scaled


def _compile_judge(*, accelerated: bool, cubic: bool) -> Any:
    @_jit
    def compiled(
        coefficients: Any,
        view: Any,
        fields: Any,
        bad: Any,
        gain: Any,
        offset: Any,
        block: Any,
        first_image: Any,
        origin: Any,
        sums: Any,
        rows: Any,
    ) -> None:
        count, height, width = coefficients.shape
        flat = coefficients.reshape((count, height * width))
        every, at = np.empty(width, dtype=np.int64), np.empty((2, width))
        samples = np.empty((3, width), dtype=np.float32)
        every_offset, fractions = np.empty(width, dtype=np.int64), np.empty((2, width), dtype=np.float32)
        for y in range(rows[0], rows[1]):
            size = find_columns(fields, y, every)
            columns, offsets = every[:size], every_offset[:size]
            at_x, at_y, right, down = at[0, :size], at[1, :size], fractions[0, :size], fractions[1, :size]
            for i in range(count):
                number = first_image + i
                s, s_y, t = view.s[number], view.s_y[number], view.t[number]
                place_columns(accelerated, view, number, fields, y, columns, at_x, at_y)
                find_offsets(at_x, at_y, height, width, bad[min(i, bad.shape[0] - 1)], offsets, right, down)
                if cubic:
                    sample_cubic(flat[i], offsets, width, right, down, samples)
                else:
                    sample_quintic(flat[i], offsets, width, right, down, samples)
                sides = (True, s <= 0.0, s >= 0.0, t <= 0.0, t >= 0.0, s_y <= 0.0, s_y >= 0.0)
                for n in range(size):
                    if offsets[n] < 0:
                        continue
                    x = columns[n]
                    value = _normalised(samples[0, n], gain[number], offset[number], block, y, x)
                    if np.isnan(origin[y - rows[0], x]):
                        origin[y - rows[0], x] = value
                    v = value - origin[y - rows[0], x]
                    total = sums[y - rows[0], x]
                    for side in range(SIDES):
                        if sides[side]:
                            total[side, 0] += 1.0
                            total[side, 1] += v
                            total[side, 2] += v * v

    return compiled


_JUDGES = {
    (fields, order): _compile_judge(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


@_jit
def _variances(sums: Any, out: Any, rows: Any) -> None:
    """Write the variances from numbers, sums and squares."""
    for y in range(rows[0], rows[1]):
        for x in range(out.shape[2]):
            for side in range(SIDES):
                n, total, squares = sums[y - rows[0], x, side]
                out[side, y, x] = (squares - total**2 / n) / (n - 1.0) if n >= _LEAST else np.nan


def judge_rows(
    coefficients: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    view: ImageView,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8] | Sequence[NDArray[np.uint8]],
    gain: NDArray[np.float32],
    offset: NDArray[np.float32],
    block: int,
    out: NDArray[np.float32],
    rows: tuple[int, int],
) -> None:
    """Compute the variances of the grey values of the images at every pixel.

    ``coefficients``, ``bad``: Arrays or lists of arrays, as in `warp_rows`.
    ``gain``, ``offset``: Normalisation of the image intensities, (value - offset) / gain, in blocks of pixels, shape
      (n, rows of blocks, columns of blocks); interpolated linearly.
    ``block``: Side length of a block in px.
    ``out``: Variances of the images of `SIDES`, NaN where fewer than three are valid, shape (7, height, width).
    """
    kernel, first = _JUDGES[len(fields), view.spline], 0
    origin = np.full((rows[1] - rows[0], out.shape[2]), np.nan)
    sums = np.zeros((*origin.shape, SIDES, 3))
    for part, flags in image_parts(coefficients, bad):
        kernel(part, view, fields, flags, gain, offset, block, first, origin, sums, rows)
        first += len(part)
    _variances(sums, out, rows)


_jit_exact = numba.njit(cache=True, nogil=True, error_model="numpy")

# Distance in px from an occluding surface within which grey values are a mixture.
_MARGIN = 1


@numba.njit(inline="always")
def _place_row(accelerated: Any, view: Any, i: Any, fields: Any, y: Any, at_x: Any, at_y: Any, disparity: Any) -> Any:
    """Write the positions of the points of the pixels of a row in an image, and their disparities there."""
    s, s_y, t = view.s[i], view.s_y[i], view.t[i]
    for x in range(at_x.size):
        right, down, scale = place_of(accelerated, view, s, s_y, t, fields, y, x)
        at_x[x], at_y[x] = corrected(view, i, right, down)
        disparity[x] = abs(fields[0, y, x] * scale)


@_jit_exact
def _largest_around(values: Any, scratch: Any) -> None:
    """Replace values by the largest of the pixels at a distance of up to `_MARGIN` along rows and columns."""
    height, width = values.shape
    for y in range(height):
        line, out = values[y], scratch[y]
        for x in range(width):
            out[x] = line[x]
        for shift in range(1, _MARGIN + 1):
            for x in range(width - shift):
                out[x] = max(out[x], line[x + shift])
            for x in range(shift, width):
                out[x] = max(out[x], line[x - shift])
    for y in range(height):
        out = values[y]
        out[:] = scratch[y]
        for v in range(max(y - _MARGIN, 0), min(y + _MARGIN + 1, height)):
            line = scratch[v]
            for x in range(width):
                out[x] = max(out[x], line[x])


def _compile_visibility(*, accelerated: bool) -> Any:
    @_jit_exact
    def compiled(view: Any, fields: Any, tolerance_px: Any, hidden: Any, group: Any) -> None:
        _, rows, columns = fields.shape
        height, width = view.size if view.size[0] > 0 else (rows, columns)
        largest = np.empty((height, width), dtype=np.float32)
        scratch = np.empty((height, width), dtype=np.float32)
        at_x, at_y, disparity = np.empty(columns), np.empty(columns), np.empty(columns)
        hidden[group] = 0
        for i in range(8 * group, min(8 * group + 8, len(view.s))):
            if view.s[i] == 0.0 and view.s_y[i] == 0.0 and view.t[i] == 0.0:
                continue
            largest[:] = 0.0
            for y in range(rows):
                _place_row(accelerated, view, i, fields, y, at_x, at_y, disparity)
                for x in range(columns):
                    if at_x[x] >= 0 and at_x[x] < width - 1 and at_y[x] >= 0 and at_y[x] < height - 1:
                        left, top, d = int(at_x[x]), int(at_y[x]), np.float32(disparity[x])
                        # The four surrounding pixels, which avoids gaps.
                        largest[top, left] = max(largest[top, left], d)
                        largest[top, left + 1] = max(largest[top, left + 1], d)
                        largest[top + 1, left] = max(largest[top + 1, left], d)
                        largest[top + 1, left + 1] = max(largest[top + 1, left + 1], d)
            _largest_around(largest, scratch)
            for y in range(rows):
                _place_row(accelerated, view, i, fields, y, at_x, at_y, disparity)
                for x in range(columns):
                    if not (at_x[x] >= 0 and at_x[x] < width - 1 and at_y[x] >= 0 and at_y[x] < height - 1):
                        continue
                    if largest[int(at_y[x] + 0.5), int(at_x[x] + 0.5)] > disparity[x] + tolerance_px:
                        hidden[group, y, x] |= np.uint8(1 << (i & 7))

    return compiled


_HIDES = {STEADY: _compile_visibility(accelerated=False), ACCELERATED: _compile_visibility(accelerated=True)}


def hide(
    view: ImageView,
    fields: NDArray[np.float64],
    tolerance_px: float,
    hidden: NDArray[np.uint8],
    group: int,
) -> None:
    """Mark the pixels whose points are occluded in eight of the images.

    A point is occluded where another point of larger disparity is at the same or an adjacent pixel.

    ``hidden``: Output: bit i % 8 of the byte i // 8 for image i, shape (n / 8, height, width).
    """
    _HIDES[len(fields)](view, fields, tolerance_px, hidden, group)

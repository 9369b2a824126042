"""Kernels that compare the warped images: agreement at every pixel, occlusion, and shifts of blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.spline_samples import cubic_values, quintic_values
from scenetruth.estimators.refined.kernels.warp import (
    ACCELERATED,
    CUBIC,
    QUINTIC,
    STEADY,
    ImageView,
    corrected,
    find_offsets,
    image_parts,
    mean_of_row,
    place_columns,
    place_of,
)
from scenetruth.estimators.refined.kernels.window_solver import CURVED, FULL
from scenetruth.kernels import kernel

__all__ = ["LANES", "SIDES", "SUMS", "add_shifts", "carry_models", "compute_costs", "hide", "judge_pixels"]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

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
LANES = 8
"""Number of variances of a pixel: those of `SIDES`, and one that is not used."""
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
        brightness: Any,
        block: Any,
        first_image: Any,
        pixels: Any,
        origin: Any,
        sums: Any,
    ) -> None:
        count, height, width = coefficients.shape
        gain, offset = brightness
        flat = coefficients.reshape((count, height * width))
        every_offset, at = np.empty(width, dtype=np.int64), np.empty((2, width))
        samples, fractions = np.empty(width, dtype=np.float32), np.empty((2, width), dtype=np.float32)
        share, first = np.empty(LANES, dtype=np.float32), 0
        while first < len(pixels):
            y, last = pixels[first, 0], first
            while last < len(pixels) and pixels[last, 0] == y:
                last += 1
            size = last - first
            columns, offsets = pixels[first:last, 1], every_offset[:size]
            at_x, at_y, right, down = at[0, :size], at[1, :size], fractions[0, :size], fractions[1, :size]
            for i in range(count):
                number = first_image + i
                s, s_y, t = view.s[number], view.s_y[number], view.t[number]
                place_columns(accelerated, view, number, fields, y, columns, at_x, at_y)
                find_offsets(at_x, at_y, height, width, bad[min(i, bad.shape[0] - 1)], offsets, right, down)
                if cubic:
                    cubic_values(flat[i], offsets, width, right, down, samples)
                else:
                    quintic_values(flat[i], offsets, width, right, down, samples)
                sides = (True, s <= 0.0, s >= 0.0, t <= 0.0, t >= 0.0, s_y <= 0.0, s_y >= 0.0, False)
                for side in range(LANES):
                    share[side] = np.float32(1.0) if sides[side] else np.float32(0.0)
                for n in range(size):
                    if offsets[n] < 0:
                        continue
                    value = _normalised(samples[n], gain[number], offset[number], block, y, columns[n])
                    if np.isnan(origin[first + n]):
                        origin[first + n] = value
                    v = np.float32(value - origin[first + n])
                    total = sums[first + n]
                    for side in range(LANES):
                        total[0, side] += share[side]
                        total[1, side] += share[side] * v
                        total[2, side] += share[side] * v * v
            first = last

    return compiled


_JUDGES = {
    (fields, order): _compile_judge(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


@_jit
def _variances(sums: Any, out: Any) -> None:
    """Write the variances from numbers, sums and squares."""
    for place in range(len(sums)):
        for side in range(SIDES):
            n, total, squares = sums[place, 0, side], sums[place, 1, side], sums[place, 2, side]
            out[place, side] = (squares - total**2 / n) / (n - 1.0) if n >= _LEAST else np.nan


def judge_pixels(
    coefficients: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    view: ImageView,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8] | Sequence[NDArray[np.uint8]],
    brightness: tuple[NDArray[np.float32], NDArray[np.float32]],
    block: int,
    pixels: NDArray[np.int64],
    out: NDArray[np.float32],
    part: tuple[int, int],
) -> None:
    """Compute the variances of the grey values of the images at pixels.

    ``coefficients``, ``bad``: Arrays or lists of arrays, as in `warp_rows`.
    ``fields``: As in `warp_rows`; only those of the pixels are read.
    ``brightness``: Gain and offset of the image intensities, (value - offset) / gain, in blocks of pixels, shape
      (n, rows of blocks, columns of blocks); interpolated linearly.
    ``block``: Side length of a block in px.
    ``pixels``: Rows and columns, in the order of rows, shape (m, 2).
    ``out``: Variances of the images of `SIDES`, NaN where fewer than three are valid, shape (m, 7 or more).
    ``part``: First and last + 1 of the pixels that are evaluated.
    """
    kernel, first = _JUDGES[len(fields), view.spline], 0
    within = np.ascontiguousarray(pixels[part[0] : part[1]])
    origin = np.full(len(within), np.nan, dtype=np.float32)
    sums = np.zeros((len(within), 3, LANES), dtype=np.float32)
    for images, flags in image_parts(coefficients, bad):
        kernel(images, view, fields, flags, brightness, block, first, within, origin, sums)
        first += len(images)
    _variances(sums, out[part[0] : part[1]])


@_jit
def carry_models(
    source: NDArray[np.float64],
    theta: NDArray[np.float64],
    pixels: NDArray[np.int64],
    step: tuple[int, int],
    arms: NDArray[np.float64],
    fields: NDArray[np.float64],
    moved: NDArray[np.float64],
    part: tuple[int, int],
) -> None:
    """Write the disparity and velocity at pixels that follow from the models of other pixels.

    ``source``: Parameters, shape (15 or 18, height, width).
    ``theta``: Parameters of the pixels themselves, of the same shape.
    ``pixels``: Rows and columns, shape (n, 2).
    ``step``: Columns and rows from the other pixel to each pixel.
    ``arms``: Displacement in px by a unit of disparity, and by a unit of velocity and acceleration per px of disparity.
    ``fields``: Output at the pixels: disparity, velocity and acceleration, shape (4 or 7, height, width).
    ``moved``: Output: largest displacement over all images by the difference of both models, in px; infinite where a
      pixel has no parameters, and NaN where the other has none, shape (n,).
    """
    _, height, width = source.shape
    right, down = step
    x, y = float(right), float(down)
    for number in range(part[0], part[1]):
        row, column = pixels[number]
        v, u = row - down, column - right
        moved[number] = np.nan
        if v < 0 or v >= height or u < 0 or u >= width:
            continue
        d = source[0, v, u] + source[1, v, u] * x + source[2, v, u] * y
        d += source[3, v, u] * x * x + source[4, v, u] * x * y + source[5, v, u] * y * y
        if np.isnan(d):
            continue
        fields[0, row, column] = d
        own = theta[0, row, column]
        largest = np.inf if np.isnan(own) else abs(d - own) * arms[0]
        for k in range(1, len(fields)):
            place = CURVED + 3 * (k - 1) if k < STEADY else FULL + k - STEADY
            value = source[place, v, u]
            if k < STEADY:
                value += source[place + 1, v, u] * x + source[place + 2, v, u] * y
            fields[k, row, column] = value
            largest = max(largest, abs(value - theta[place, row, column]) * abs(own) * arms[k])
        moved[number] = largest


# Means over a pixel and its neighbours, in a Gaussian window of a standard deviation of 1 px.
_REACH = 2
_WEIGHTS = np.exp(-0.5 * np.arange(-_REACH, _REACH + 1) ** 2)
_WEIGHTS = (_WEIGHTS / _WEIGHTS.sum()).astype(np.float32)


@_jit
def _inside(n: int, size: int) -> int:
    """Return an index in an array that is mirrored at its ends."""
    return min(max(-1 - n if n < 0 else (2 * size - 1 - n if n >= size else n), 0), size - 1)


@_jit
def compute_costs(
    sides: NDArray[np.float32],
    pixels: NDArray[np.int64],
    least: float,
    side_cost: float,
    out: NDArray[np.float32],
    part: tuple[int, int],
) -> None:
    """Compute the residual over pixels and their neighbours: the smallest mean variance of the images of `SIDES`.

    ``sides``: Variances, NaN where unknown, shape (height, width, 8).
    ``pixels``: Rows and columns, shape (n, 2).
    ``least``: Smallest fraction of the neighbourhood with a valid variance.
    ``side_cost``: Factor of the variances of one side.
    ``out``: Output, infinite where fewer are valid, shape (n,).
    """
    height, width, _ = sides.shape
    total, share = np.empty(LANES, dtype=np.float32), np.empty(LANES, dtype=np.float32)
    for number in range(part[0], part[1]):
        y, x = pixels[number]
        total[:], share[:] = np.float32(0.0), np.float32(0.0)
        for down in range(-_REACH, _REACH + 1):
            row = sides[_inside(y + down, height)]
            for right in range(-_REACH, _REACH + 1):
                weight = _WEIGHTS[down + _REACH] * _WEIGHTS[right + _REACH]
                values = row[_inside(x + right, width)]
                for side in range(LANES):
                    known = values[side] == values[side]
                    share[side] += weight if known else np.float32(0.0)
                    total[side] += weight * values[side] if known else np.float32(0.0)
        best = np.inf
        for side in range(SIDES):
            if share[side] > least:
                best = min(best, total[side] / share[side] * (1.0 if side == 0 else side_cost))
        out[number] = best


_jit_exact = kernel(error_model="numpy")

# Distance in px from an occluding surface within which grey values are a mixture.
_MARGIN = 1


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
        for x in range(width):
            out[x] = scratch[y, x]
        for v in range(max(y - _MARGIN, 0), min(y + _MARGIN + 1, height)):
            line = scratch[v]
            for x in range(width):
                out[x] = max(out[x], line[x])


def _compile_visibility(*, accelerated: bool) -> Any:
    @_jit_exact
    def compiled(view: Any, fields: Any, tolerance_px: Any, hidden: Any, group: Any, box: Any) -> None:
        height, width = view.size if view.size[0] > 0 else fields.shape[1:]
        top, bottom, first, last = box
        size = (bottom - top) * (last - first)
        # Row and column of the points in an image, -1 outside, and their disparities there.
        at_x, at_y = np.empty(size, dtype=np.float32), np.empty(size, dtype=np.float32)
        disparity = np.empty(size, dtype=np.float32)
        largest = np.zeros((height, width), dtype=np.float32)
        scratch = np.empty((height, width), dtype=np.float32)
        hidden[group] = 0
        for i in range(8 * group, min(8 * group + 8, len(view.s))):
            if view.s[i] == 0.0 and view.s_y[i] == 0.0 and view.t[i] == 0.0:
                continue
            s, s_y, t = view.s[i], view.s_y[i], view.t[i]
            n, highest, lowest = 0, height, -1
            for y in range(top, bottom):
                for x in range(first, last):
                    right, down, scale = place_of(accelerated, view, s, s_y, t, fields, y, x)
                    right, down = corrected(view, i, right, down)
                    inside = right >= 0 and right < width - 1 and down >= 0 and down < height - 1
                    at_x[n], at_y[n] = (right if inside else -1.0), (down if inside else -1.0)
                    d = np.float32(abs(fields[0, y, x] * scale))
                    disparity[n] = d
                    n += 1
                    if not inside:
                        continue
                    left, above = int(right), int(down)
                    highest, lowest = min(highest, above), max(lowest, above + 1)
                    # The four surrounding pixels, which avoids gaps.
                    largest[above, left] = max(largest[above, left], d)
                    largest[above, left + 1] = max(largest[above, left + 1], d)
                    largest[above + 1, left] = max(largest[above + 1, left], d)
                    largest[above + 1, left + 1] = max(largest[above + 1, left + 1], d)
            if lowest < 0:
                continue
            highest, lowest = max(highest - _MARGIN, 0), min(lowest + _MARGIN, height - 1)
            _largest_around(largest[highest : lowest + 1], scratch)
            n = 0
            for y in range(top, bottom):
                for x in range(first, last):
                    behind = disparity[n] + tolerance_px
                    if at_x[n] >= 0 and largest[int(at_y[n] + 0.5), int(at_x[n] + 0.5)] > behind:
                        hidden[group, y, x] |= np.uint8(1 << (i & 7))
                    n += 1
            largest[highest : lowest + 1] = 0.0

    return compiled


_HIDES = {STEADY: _compile_visibility(accelerated=False), ACCELERATED: _compile_visibility(accelerated=True)}


def hide(
    view: ImageView,
    fields: NDArray[np.float64],
    tolerance_px: float,
    hidden: NDArray[np.uint8],
    group: int,
    box: tuple[int, int, int, int] | None = None,
) -> None:
    """Mark the pixels whose points are occluded in eight of the images.

    A point is occluded where another point of larger disparity is at the same or an adjacent pixel.

    ``hidden``: Output: bit i % 8 of the byte i // 8 for image i, shape (n / 8, height, width).
    ``box``: First row, last + 1, first column and last + 1 of the points; default: all.
    """
    whole = (0, fields.shape[1], 0, fields.shape[2])
    _HIDES[len(fields)](view, fields, tolerance_px, hidden, group, whole if box is None else box)

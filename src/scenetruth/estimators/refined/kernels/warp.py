"""Kernels that interpolate images at the points predicted by surface and motion, and at defective pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.spline_samples import sample_cubic, sample_quintic
from scenetruth.kernels import kernel

__all__ = [
    "ACCELERATED",
    "CUBIC",
    "QUINTIC",
    "REACH",
    "STEADY",
    "ImageView",
    "corrected",
    "distorted",
    "find_columns",
    "find_offsets",
    "image_parts",
    "mean_of_row",
    "mean_texture",
    "place_columns",
    "place_of",
    "smooth_over",
    "straightened",
    "warp_rows",
]


# Reassociation and contraction only: NaN must stay NaN.
_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

STEADY, ACCELERATED = 4, 7
"""Numbers of fields: d, q_X, q_Y, q_Z, and for accelerated motion a_X, a_Y, a_Z."""
CUBIC, QUINTIC = 3, 5
"""Orders of the splines through the images."""
_FAR_OUTSIDE = 1e9
REACH = 2  # taps before the integer part of the sample position


class ImageView(NamedTuple):
    """Camera positions and times of the images, and intrinsics; the reference is s = 0 at t = 0."""

    s: NDArray[np.float64]
    """Position along the stage in steps, of every image, shape (n,)."""
    s_y: NDArray[np.float64]
    """Position across the stage in the same steps, shape (n,)."""
    t: NDArray[np.float64]
    """Time in frames, shape (n,)."""
    moved: NDArray[np.float64]
    """Pose corrections of the images, as in `corrected`, shape (n, 4)."""
    focal: float
    """Focal length in columns."""
    centre_x: float
    """Column of the principal point."""
    centre_y: float
    """Row of the principal point."""
    spline: int = 5
    """Order of the splines through the images, 5 or 3."""
    row_time: float = 0.0
    """Rolling shutter: time from one row to the next, in frames."""
    row_step: float = 0.0
    """Movement of the camera along the stage from one row to the next, in steps."""
    lens: NDArray[np.float64] = np.zeros(0)
    """Distortion (k1, k2, p1, p2, k3, k4, k5, k6) and the largest squared radius in the image; empty for a pinhole."""
    origin: NDArray[np.float64] = np.zeros((0, 2))
    """Column and row at which the array of each image begins, shape (n, 2); empty if at the first pixel."""
    size: tuple[int, int] = (0, 0)
    """Numbers of rows and columns of the arrays of the images; 0 if those of the fields."""


@numba.njit(inline="always")
def corrected(view: Any, i: Any, x: Any, y: Any) -> Any:
    """Return column and row in the array of an image of the nominal position (x, y) relative to the principal point.

    This is where the lens shows it. The corrections in ``view.moved`` are, in this order, shifts along x and y in px, a
    roll from x towards y in rad, and a relative scale: to first order.
    """
    right, down, roll, larger = view.moved[i, 0], view.moved[i, 1], view.moved[i, 2], view.moved[i, 3]
    x, y = x + right - roll * y + larger * x, y + down + roll * x + larger * y
    if view.lens.shape[0] > 0:
        x, y = distorted(view, x, y)
    if view.origin.shape[0] > 0:
        return x + view.centre_x - view.origin[i, 0], y + view.centre_y - view.origin[i, 1]
    return x + view.centre_x, y + view.centre_y


@numba.njit(inline="always")
def distorted(view: Any, x: Any, y: Any) -> Any:
    """Return where the lens shows a position, both relative to the principal point; far outside beyond the image."""
    k = view.lens
    x, y = x / view.focal, y / view.focal
    square = x * x + y * y
    if square > k[8]:
        return -_FAR_OUTSIDE, -_FAR_OUTSIDE
    radial = 1.0 + square * (k[0] + square * (k[1] + square * k[4]))
    radial /= 1.0 + square * (k[5] + square * (k[6] + square * k[7]))
    right = x * radial + 2.0 * k[2] * x * y + k[3] * (square + 2.0 * x * x)
    down = y * radial + k[2] * (square + 2.0 * y * y) + 2.0 * k[3] * x * y
    return view.focal * right, view.focal * down


@numba.njit(inline="always")
def straightened(view: Any, x: Any, y: Any, along: Any, down: Any) -> Any:
    """Return derivatives by pinhole positions from those by distorted positions, at a pixel of the pinhole camera."""
    if view.lens.shape[0] == 0:
        return along, down
    k = view.lens
    x, y = (x - view.centre_x) / view.focal, (y - view.centre_y) / view.focal
    square = x * x + y * y
    below = 1.0 + square * (k[5] + square * (k[6] + square * k[7]))
    radial = (1.0 + square * (k[0] + square * (k[1] + square * k[4]))) / below
    slope = k[0] + square * (2.0 * k[1] + square * 3.0 * k[4])
    slope = (slope - radial * (k[5] + square * (2.0 * k[6] + square * 3.0 * k[7]))) / below
    a = radial + 2.0 * x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
    b = 2.0 * x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
    d = radial + 2.0 * y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
    return np.float32(a * along + b * down), np.float32(b * along + d * down)


@numba.njit(inline="always")
def place_of(accelerated: Any, view: Any, s: Any, s_y: Any, t: Any, fields: Any, y: Any, x: Any) -> Any:
    """Return the position of a pixel's point in an image, relative to the principal point, and its scale.

    These are x', y' and 1 / (1 + t d q_Z / f) of `warp_rows`. With a rolling shutter, fields are those at the time of
    the pixel's own row, and the image is taken at the time of the row where it shows the point. Acceleration is a
    compile-time constant, because a condition at every pixel doubles the time.
    """
    d = fields[0, y, x]
    if view.row_time != 0.0:
        # Rows from the pixel to its point, to first order: both rows have their own times.
        rows = d * (t * fields[2, y, x] - s_y - (y - view.centre_y) * t * fields[3, y, x] / view.focal)
        t += view.row_time * rows
        s += view.row_step * rows
    right, down, ahead = t * fields[1, y, x], t * fields[2, y, x], t * fields[3, y, x]
    if accelerated:
        half = 0.5 * t * t
        right += half * fields[4, y, x]
        down += half * fields[5, y, x]
        ahead += half * fields[6, y, x]
    scale = 1.0 / (1.0 + d * ahead / view.focal)
    return (x - view.centre_x + d * (right - s)) * scale, (y - view.centre_y + d * (down - s_y)) * scale, scale


@numba.njit(inline="always")
def place_columns(accelerated: Any, view: Any, i: Any, fields: Any, y: Any, columns: Any, at_x: Any, at_y: Any) -> Any:
    """Write column and row in an image of the points of the pixels of a row."""
    s, s_y, t = view.s[i], view.s_y[i], view.t[i]
    for n in range(columns.size):
        x, down, _ = place_of(accelerated, view, s, s_y, t, fields, y, columns[n])
        at_x[n], at_y[n] = corrected(view, i, x, down)


@numba.njit(inline="always")
def find_columns(fields: Any, y: Any, columns: Any) -> Any:
    """Write the columns of a row whose fields are finite; return their number."""
    count = 0
    for x in range(fields.shape[2]):
        if not np.isnan(fields[0, y, x]):
            columns[count] = x
            count += 1
    return count


@numba.njit(inline="always")
def find_offsets(at_x: Any, at_y: Any, height: Any, width: Any, bad: Any, offsets: Any, right: Any, down: Any) -> Any:
    """Write the offsets of samples in an image, -1 where it must not be sampled, and their fractions of a step."""
    for n in range(offsets.size):
        x, y = at_x[n], at_y[n]
        inside = x >= REACH and x < width - 3 and y >= REACH and y < height - 3
        left, top = int(x) if inside else REACH, int(y) if inside else REACH
        right[n], down[n] = (x - left if inside else 0.0), (y - top if inside else 0.0)
        offsets[n] = (top - REACH) * width + left - REACH if inside else -1
    if bad.shape[0] > 0:
        for n in range(offsets.size):
            if offsets[n] >= 0 and bad[int(at_y[n] + 0.5), int(at_x[n] + 0.5)] != 0:
                offsets[n] = -1


def _compiled_warp(*, accelerated: bool, cubic: bool) -> Any:
    @_jit
    def compiled(
        coefficients: Any,
        view: Any,
        fields: Any,
        hidden: Any,
        bad: Any,
        first_row: Any,
        first_image: Any,
        warped: Any,
        gradient: Any,
        used: Any,
        rows: Any,
    ) -> None:
        count, height, width = coefficients.shape
        flat = coefficients.reshape((count, height * width))
        every, at = np.empty(width, dtype=np.int64), np.empty((2, width))
        samples = np.empty((3, width), dtype=np.float32)
        every_offset, fractions = np.empty(width, dtype=np.int64), np.empty((2, width), dtype=np.float32)
        for row in range(rows[0], rows[1]):
            y = row + first_row
            size = find_columns(fields, y, every)
            columns, offsets = every[:size], every_offset[:size]
            at_x, at_y, right, down = at[0, :size], at[1, :size], fractions[0, :size], fractions[1, :size]
            along, below, numbers = gradient[0, row], gradient[1, row], used[row - rows[0]]
            for i in range(count):
                number = first_image + i
                values, image = warped[number, row], flat[i]
                values[:] = np.float32(np.nan)
                place_columns(accelerated, view, number, fields, y, columns, at_x, at_y)
                find_offsets(at_x, at_y, height, width, bad[min(i, bad.shape[0] - 1)], offsets, right, down)
                if hidden.shape[0] > 0:
                    for n in range(size):
                        if (hidden[number >> 3, y, columns[n]] >> (number & 7)) & 1 != 0:
                            offsets[n] = -1
                if cubic:
                    sample_cubic(image, offsets, width, right, down, samples)
                else:
                    sample_quintic(image, offsets, width, right, down, samples)
                for n in range(size):
                    if offsets[n] >= 0:
                        x = columns[n]
                        values[x] = samples[0, n]
                        along[x] += samples[1, n]
                        below[x] += samples[2, n]
                        numbers[x] += 1

    return compiled


@_jit
def _average_gradient(view: Any, used: Any, first_row: Any, gradient: Any, rows: Any) -> None:
    """Divide the sums of the derivatives by the numbers of images."""
    for row in range(rows[0], rows[1]):
        for x in range(used.shape[1]):
            share = np.float32(1.0 / max(used[row - rows[0], x], 1))
            along, down = share * gradient[0, row, x], share * gradient[1, row, x]
            gradient[0, row, x], gradient[1, row, x] = straightened(view, x, row + first_row, along, down)


_WARPS = {
    (fields, order): _compiled_warp(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


def warp_rows(
    coefficients: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    view: ImageView,
    fields: NDArray[np.float64],
    hidden: NDArray[np.uint8],
    bad: NDArray[np.uint8] | Sequence[NDArray[np.uint8]],
    first_row: int,
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    rows: tuple[int, int],
) -> None:
    """Sample all images at the points of the pixels of the reference camera, by B-spline interpolation.

    In camera (s, s_y) at time t, the point of a pixel at (x, y) from the principal point is at

        x' = (x + d (t q_X - s)) / (1 + t d q_Z / f)        y' = (y + d (t q_Y - s_y)) / (1 + t d q_Z / f)

    with the disparity d in px per step and the velocity q in steps per frame (paper, eq. 2 and 3), then displaced by
    `corrected`. With an acceleration a in steps per frame², t q is replaced by t q + ½ t² a.

    ``coefficients``: Spline coefficients, shape (n, height, width), or a list of such arrays.
    ``fields``: d, q_X, q_Y, q_Z of every pixel, for accelerated motion also a_X, a_Y, a_Z, shape (4, height, width) or
      (7, height, width); NaN where not required.
    ``hidden``: Occlusion of the points by image, as from `photo_consistency.hide`; shape (0, 0, 0) for none.
    ``bad``: Nonzero at pixels whose surroundings must not be sampled, shape (n, height, width); (0, 0, 0) for none.
      With a list of coefficients, a list of the same length.
    ``warped``: Output: grey values, NaN where a point is outside the image, occluded, or at defective pixels, shape
      (n, rows, width).
    ``gradient``: Output: grey-value derivatives along x and y, averaged over the images, shape (2, rows, width).
    """
    kernel, first = _WARPS[len(fields), view.spline], 0
    images = sum(len(part) for part, _ in image_parts(coefficients, bad))
    if len(warped) != images:
        msg = f"warped has {len(warped)} images for {images}"
        raise ValueError(msg)
    used = np.zeros((rows[1] - rows[0], warped.shape[2]), dtype=np.int64)
    gradient[:, rows[0] : rows[1]] = 0.0
    for part, flags in image_parts(coefficients, bad):
        kernel(part, view, fields, hidden, flags, first_row, first, warped, gradient, used, rows)
        first += len(part)
    _average_gradient(view, used, first_row, gradient, rows)


def image_parts(
    coefficients: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    bad: NDArray[np.uint8] | Sequence[NDArray[np.uint8]],
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.uint8]]]:
    """Yield the images of an array or a list of arrays, with their defective pixels."""
    single = isinstance(coefficients, np.ndarray)
    yield from zip([coefficients] if single else coefficients, [bad] if single else bad, strict=True)


@_jit
def mean_of_row(warped: Any, row: int, least: int, mean: Any) -> None:
    """Write the mean of the images at the pixels of a row, NaN where fewer than ``least`` are valid."""
    count, _, width = warped.shape
    used = np.zeros(width, dtype=np.int64)
    mean[:] = 0.0
    for i in range(count):
        for x in range(width):
            g = warped[i, row, x]
            if not np.isnan(g):
                mean[x] += g
                used[x] += 1
    for x in range(width):
        mean[x] = mean[x] / used[x] if used[x] >= least else np.nan


@_jit
def mean_texture(warped: NDArray[np.float32], least: int, texture: NDArray[np.float32], rows: tuple[int, int]) -> None:
    """Compute the mean of the images at each pixel, shape (rows, width), NaN where fewer than ``least`` are valid."""
    mean = np.empty(warped.shape[2])
    for row in range(rows[0], rows[1]):
        mean_of_row(warped, row, least, mean)
        for x in range(len(mean)):
            texture[row, x] = mean[x]


_jit_exact = kernel(error_model="numpy")


@numba.njit(inline="always")
def _inside(n: Any, size: Any) -> Any:
    """Return an index within the image; beyond the ends, the image is mirrored at its last pixels."""
    n = abs(n)
    return max(2 * (size - 1) - n, 0) if n >= size else n


@_jit_exact
def smooth_over(image: NDArray[np.float64], pixels: NDArray[np.int64], sweeps: int) -> None:
    """Interpolate pixels by minimising the squared Laplacian of the image, with the other pixels fixed.

    A single pixel becomes, after one sweep, the continuation of any polynomial of third degree: (8 a - 2 b - c) / 20
    with the sums a over the four adjacent pixels, b over the four diagonal pixels, c over the four at distance two.

    ``image``: Finite grey values, shape (y, x); modified at these pixels.
    ``pixels``: Rows and columns of the pixels, shape (n, 2).
    """
    height, width = image.shape
    for _ in range(sweeps):
        for n in range(len(pixels)):
            y, x = pixels[n]
            up, down = _inside(y - 1, height), _inside(y + 1, height)
            left, right = _inside(x - 1, width), _inside(x + 1, width)
            near = image[up, x] + image[down, x] + image[y, left] + image[y, right]
            across = image[up, left] + image[up, right] + image[down, left] + image[down, right]
            far = image[_inside(y - 2, height), x] + image[_inside(y + 2, height), x]
            far += image[y, _inside(x - 2, width)] + image[y, _inside(x + 2, width)]
            image[y, x] = (8.0 * near - 2.0 * across - far) / 20.0

"""Kernels that interpolate images.

At the points that surface and motion of a pixel predict, and at defective pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ACCELERATED",
    "CUBIC",
    "QUINTIC",
    "REACH",
    "STEADY",
    "TAPS",
    "ImageView",
    "corrected",
    "cubic_weights",
    "mean_of_row",
    "mean_texture",
    "place_of",
    "quintic_weights",
    "smooth_over",
    "warp_rows",
]


# Reassociation and contraction only: NaN must stay NaN.
_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

STEADY, ACCELERATED = 4, 7
"""Fields of a point: d, q_X, q_Y, q_Z if it moves steadily; if not, the acceleration a_X, a_Y, a_Z behind them."""
CUBIC, QUINTIC = 3, 5
"""Orders of the splines through the images."""
TAPS = 6
REACH = 2  # taps before the sample's whole coordinate


class ImageView(NamedTuple):
    """Which camera took each image when, and how cameras see; the reference is s = 0 at t = 0."""

    s: NDArray[np.float64]
    """Position along the stage in steps, of every image, shape (n,)."""
    s_y: NDArray[np.float64]
    """Position across the stage in the same steps, shape (n,)."""
    t: NDArray[np.float64]
    """Time in frames, shape (n,)."""
    moved: NDArray[np.float64]
    """How far the images are from where they should be, as of `corrected`, shape (n, 4)."""
    focal: float
    """Focal length in columns."""
    centre_x: float
    """Column of the principal point."""
    centre_y: float
    """Row of the principal point."""
    spline: int = 5
    """Order of the splines through the images, 5 or 3."""


@numba.njit(inline="always")
def corrected(view: Any, i: Any, x: Any, y: Any) -> Any:
    """Return column and row at which an image shows what it should show at (x, y) from the principal point.

    It is moved by x and y in px, rolled from x towards y by an angle in rad, and larger by a share, in this order in
    ``view.moved``: to the first order.
    """
    right, down, roll, larger = view.moved[i, 0], view.moved[i, 1], view.moved[i, 2], view.moved[i, 3]
    return (
        x + right - roll * y + larger * x + view.centre_x,
        y + down + roll * x + larger * y + view.centre_y,
    )


@numba.njit(inline="always")
def place_of(accelerated: Any, view: Any, s: Any, s_y: Any, t: Any, fields: Any, y: Any, x: Any) -> Any:
    """Return where an image should show the point of a pixel, from the principal point, and by what share it shrinks.

    These are x', y' and 1 / (1 + t d q_Z / f) of `warp_rows`. Kernels know when they are compiled whether motion is
    accelerated: to ask at every pixel takes twice the time.
    """
    d = fields[0, y, x]
    right, down, ahead = t * fields[1, y, x], t * fields[2, y, x], t * fields[3, y, x]
    if accelerated:
        half = 0.5 * t * t
        right += half * fields[4, y, x]
        down += half * fields[5, y, x]
        ahead += half * fields[6, y, x]
    scale = 1.0 / (1.0 + d * ahead / view.focal)
    return (x - view.centre_x + d * (right - s)) * scale, (y - view.centre_y + d * (down - s_y)) * scale, scale


@numba.njit(inline="always")
def _far(f: Any) -> Any:
    """Return 120 times the quintic B-spline at the distance 2 - f, for f from 0 to 1."""
    return 1.0 + f * (5.0 + f * (10.0 + f * (10.0 + f * (5.0 - 5.0 * f))))


@numba.njit(inline="always")
def _far_slope(f: Any) -> Any:
    return 5.0 + f * (20.0 + f * (30.0 + f * (20.0 - 25.0 * f)))


@numba.njit(inline="always")
def _near(f: Any) -> Any:
    """Return 120 times the quintic B-spline at the distance 1 - f, for f from 0 to 1."""
    return 26.0 + f * (50.0 + f * (20.0 + f * (-20.0 + f * (-20.0 + 10.0 * f))))


@numba.njit(inline="always")
def _near_slope(f: Any) -> Any:
    return 50.0 + f * (40.0 + f * (-60.0 + f * (-80.0 + 50.0 * f)))


@_jit
def cubic_weights(f: float, w: Any, dw: Any) -> None:
    """Write the weights of six coefficients of a cubic spline, of which the outer ones are 0, as `quintic_weights`."""
    g = 1.0 - f
    w[0], w[1], w[2] = 0.0, g**3 / 6.0, 2.0 / 3.0 - 0.5 * f * f * (2.0 - f)
    w[3], w[4], w[5] = 2.0 / 3.0 - 0.5 * g * g * (2.0 - g), f**3 / 6.0, 0.0
    dw[0], dw[1], dw[2] = 0.0, -0.5 * g * g, f * (1.5 * f - 2.0)
    dw[3], dw[4], dw[5] = g * (2.0 - 1.5 * g), 0.5 * f * f, 0.0


@_jit
def quintic_weights(f: float, w: Any, dw: Any) -> None:
    """Write the weights of six coefficients at a fraction f of a step, and their derivatives."""
    g = 1.0 - f
    w[0], w[1], w[2] = g**5 / 120.0, _far(g) / 120.0, _near(g) / 120.0
    w[3], w[4], w[5] = _near(f) / 120.0, _far(f) / 120.0, f**5 / 120.0
    dw[0], dw[1], dw[2] = -(g**4) / 24.0, -_far_slope(g) / 120.0, -_near_slope(g) / 120.0
    dw[3], dw[4], dw[5] = _near_slope(f) / 120.0, _far_slope(f) / 120.0, f**4 / 24.0


def _compiled_warp(*, accelerated: bool, cubic: bool) -> Any:
    @_jit
    def compiled(
        coefficients: Any,
        view: Any,
        fields: Any,
        hidden: Any,
        bad: Any,
        first_row: Any,
        warped: Any,
        gradient: Any,
        rows: Any,
    ) -> None:
        count, height, width = coefficients.shape
        wx, wy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
        dx, dy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
        used = np.empty(width, dtype=np.int64)
        some, some_bad = hidden.shape[0] > 0, bad.shape[0] > 0
        for row in range(rows[0], rows[1]):
            y = row + first_row
            used[:] = 0
            gradient[:, row] = np.float32(0.0)
            for i in range(count):
                s, s_y, t = view.s[i], view.s_y[i], view.t[i]
                image = coefficients[i]
                for x in range(width):
                    at_x, at_y, _ = place_of(accelerated, view, s, s_y, t, fields, y, x)
                    at_x, at_y = corrected(view, i, at_x, at_y)
                    seen = not some or (hidden[i >> 3, y, x] >> (i & 7)) & 1 == 0
                    if not (seen and at_x >= REACH and at_x < width - 3 and at_y >= REACH and at_y < height - 3):
                        warped[i, row, x] = np.float32(np.nan)
                        continue
                    if some_bad and bad[i, int(at_y + 0.5), int(at_x + 0.5)] != 0:
                        warped[i, row, x] = np.float32(np.nan)
                        continue
                    left, top = int(at_x), int(at_y)
                    # A function for both takes half as much time again.
                    if cubic:
                        cubic_weights(at_x - left, wx, dx)
                        cubic_weights(at_y - top, wy, dy)
                    else:
                        quintic_weights(at_x - left, wx, dx)
                        quintic_weights(at_y - top, wy, dy)
                    value, along, down = np.float32(0.0), np.float32(0.0), np.float32(0.0)
                    for k in range(TAPS):
                        line = image[top + k - REACH]
                        a, b = np.float32(0.0), np.float32(0.0)
                        for j in range(TAPS):
                            c = line[left + j - REACH]
                            a += wx[j] * c
                            b += dx[j] * c
                        value += wy[k] * a
                        along += wy[k] * b
                        down += dy[k] * a
                    warped[i, row, x] = value
                    gradient[0, row, x] += along
                    gradient[1, row, x] += down
                    used[x] += 1
            for x in range(width):
                share = np.float32(1.0 / max(used[x], 1))
                gradient[0, row, x] *= share
                gradient[1, row, x] *= share

    return compiled


_WARPS = {
    (fields, order): _compiled_warp(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


def warp_rows(
    coefficients: NDArray[np.float32],
    view: ImageView,
    fields: NDArray[np.float64],
    hidden: NDArray[np.uint8],
    bad: NDArray[np.uint8],
    first_row: int,
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    rows: tuple[int, int],
) -> None:
    """Fetch all images where they see the points of the reference camera's pixels, by B-splines.

    Camera (s, s_y) sees at time t a point whose pixel lies at (x, y) from the principal point at

        x' = (x + d (t q_X - s)) / (1 + t d q_Z / f)        y' = (y + d (t q_Y - s_y)) / (1 + t d q_Z / f)

    with the disparity d in px per step and the velocity q in steps per frame (paper, eq. 2 and 3), and shows it where
    `corrected` says. With an acceleration a in steps per frame², t q + ½ t² a stand for t q.

    ``coefficients``: Coefficients of the splines, shape (n, height, width).
    ``fields``: d, q_X, q_Y, q_Z of every pixel, and a_X, a_Y, a_Z behind them if motion is not steady, shape (4,
      height, width) or (7, height, width); NaN where none is wanted.
    ``hidden``: In which images other surfaces hide the points, as of `visibility.hide`; of shape (0, 0, 0), none is
      hidden.
    ``bad``: Not 0 at pixels of the images around which nothing must be fetched, shape (n, height, width); of shape (0,
      0, 0), there are none.
    ``warped``: Output: grey values, NaN where a point lies outside the image, is hidden, or falls on bad pixels, shape
      (n, rows, width).
    ``gradient``: Output: mean over the images of the grey values' derivatives along x and y, shape (2, rows, width).
    """
    _WARPS[len(fields), view.spline](coefficients, view, fields, hidden, bad, first_row, warped, gradient, rows)


@_jit
def mean_of_row(warped: Any, row: int, least: int, mean: Any) -> None:
    """Write the mean of the images that show the pixels of a row, NaN where fewer than ``least`` do."""
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
    """Compute the mean of the images that show a pixel, NaN where fewer than ``least`` do.

    ``texture``: Output, shape (rows, width).
    """
    mean = np.empty(warped.shape[2])
    for row in range(rows[0], rows[1]):
        mean_of_row(warped, row, least, mean)
        texture[row] = mean


_jit_exact = numba.njit(cache=True, nogil=True, error_model="numpy")


@numba.njit(inline="always")
def _inside(n: Any, size: Any) -> Any:
    """Return a place within the image: beyond its ends, the image is mirrored at its last pixels."""
    n = abs(n)
    return max(2 * (size - 1) - n, 0) if n >= size else n


@_jit_exact
def smooth_over(image: NDArray[np.float64], pixels: NDArray[np.int64], sweeps: int) -> None:
    """Bring some pixels to where the squared Laplacian of the image is least, the others being fixed.

    One pixel alone gets, after one sweep, what continues any polynomial of third degree: (8 a - 2 b - c) / 20 with the
    sums a over the four next to it, b over the four across the corners, c over the four two pixels away.

    ``image``: Finite grey values, shape (y, x); these pixels are changed.
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

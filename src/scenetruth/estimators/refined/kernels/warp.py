"""Kernels that fetch every image where a pixel's own surface and motion say that its point is seen."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ACCELERATED",
    "ALL_PRODUCTS",
    "CUBIC",
    "LEAST_VARIANCE",
    "PAIR_OF",
    "PRODUCTS",
    "QUINTIC",
    "REACH",
    "SIDE_OF",
    "SQUARE_OF",
    "STEADY",
    "TAPS",
    "View",
    "add_products",
    "corrected",
    "cubic_weights",
    "is_pair",
    "mean_of_row",
    "mean_texture",
    "place_of",
    "quintic_weights",
    "warp_rows",
]

# Reassociation and contraction only: NaN must stay NaN.
_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

PRODUCTS, ALL_PRODUCTS = 22, 46
"""Maps that `add_products` fills: with the four fields d and q, and with those of the acceleration too."""
LEAST_VARIANCE = 0.01
"""Relative variance of noise, at least."""
STEADY, ACCELERATED = 4, 7
"""Fields of a point: d, q_X, q_Y, q_Z if it moves steadily; if not, the acceleration a_X, a_Y, a_Z behind them."""
CUBIC, QUINTIC = 3, 5
"""Orders of the splines through the images."""
TAPS = 6
REACH = 2  # taps before the sample's whole coordinate


def _pairs() -> NDArray[np.int64]:
    """Return which product belongs to a pair of fields."""
    found = np.zeros((7, 7), dtype=np.int64)
    found[np.triu_indices(STEADY)] = np.arange(10)
    first = PRODUCTS
    for k in range(STEADY, 7):
        found[: k + 1, k] = first + np.arange(k + 1)
        first += k + 1
    return np.maximum(found, found.T)


PAIR_OF = _pairs()
"""Which product belongs to a pair of fields, shape (7, 7)."""
SIDE_OF = np.array([10, 11, 12, 13, 40, 41, 42])
"""Which product is the part of M (d, q, a) + b that belongs to a field."""
SQUARE_OF = np.array([18, 19, 20, 21, 43, 44, 45])
"""Which product is the square of b of a field."""


class View(NamedTuple):
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
    view: View,
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

    Parameters
    ----------
    coefficients
        Coefficients of the splines, shape (n, height, width).
    view
        Where and when the images were taken.
    fields
        d, q_X, q_Y, q_Z of every pixel, and a_X, a_Y, a_Z behind them if motion is not steady, shape (4, height, width)
        or (7, height, width); NaN where none is wanted.
    hidden
        In which images other surfaces hide the points, as of `visibility.hide`; of shape (0, 0, 0), none is hidden.
    bad
        Not 0 at pixels of the images around which nothing must be fetched, shape (n, height, width); of shape
        (0, 0, 0), there are none.
    first_row
        Row of the images at which the output begins.
    warped
        Output: grey values, NaN where a point lies outside the image, is hidden, or falls on bad pixels, shape
        (n, rows, width).
    gradient
        Output: mean over the images of the grey values' derivatives along x and y, shape (2, rows, width).
    rows
        First and last + 1 of the output's rows to be filled.
    """
    _WARPS[len(fields), view.spline](coefficients, view, fields, hidden, bad, first_row, warped, gradient, rows)


def _compiled_products(several: int) -> Any:
    @_jit
    def compiled(
        view: Any,
        fields: Any,
        warped: Any,
        gradient: Any,
        first_row: Any,
        least: Any,
        variance: Any,
        products: Any,
        rows: Any,
    ) -> None:
        count, _, width = warped.shape
        a, mean, own = np.empty((count, several)), np.empty(several), np.empty(several)
        phi, pairs, sides = np.empty(several), np.empty((several, several)), np.empty(several)
        for row in range(rows[0], rows[1]):
            y = row + first_row
            for x in range(width):
                used, texture = 0, 0.0
                for i in range(count):
                    g = warped[i, row, x]
                    if not np.isnan(g):
                        texture += g
                        used += 1
                if used < least:
                    continue
                texture /= used
                for k in range(several):
                    phi[k] = fields[k, y, x]
                along, down = np.float64(gradient[0, row, x]), np.float64(gradient[1, row, x])
                mean[:] = 0.0
                for i in range(count):
                    if np.isnan(warped[i, row, x]):
                        continue
                    t = view.t[i]
                    at_x, at_y, scale = place_of(several > STEADY, view, view.s[i], view.s_y[i], t, fields, y, x)
                    share = scale / phi[0]
                    a[i, 0] = share * (along * (at_x - (x - view.centre_x)) + down * (at_y - (y - view.centre_y)))
                    a[i, 1] = scale * along * phi[0] * t
                    a[i, 2] = scale * down * phi[0] * t
                    a[i, 3] = -scale * phi[0] * t / view.focal * (along * at_x + down * at_y)
                    for k in range(STEADY, several):
                        a[i, k] = 0.5 * t * a[i, k - 3]
                    for k in range(several):
                        mean[k] += a[i, k]
                for k in range(several):
                    mean[k] /= used
                pairs[:], sides[:] = 0.0, 0.0
                squares = 0.0
                for i in range(count):
                    g = warped[i, row, x]
                    if np.isnan(g):
                        continue
                    left = texture - g
                    squares += left * left
                    for k in range(several):
                        own[k] = a[i, k] - mean[k]
                    for k in range(several):
                        sides[k] += own[k] * left
                        for m in range(k + 1):
                            pairs[k, m] += own[k] * own[m]
                # Where all is dark, noise does not vanish.
                weight = 1.0 / max(variance[0] + variance[1] * texture, LEAST_VARIANCE)
                squares *= weight
                for k in range(several):
                    sides[k] *= weight
                    products[SQUARE_OF[k], row, x] += sides[k] * sides[k]
                    for m in range(k + 1):
                        pairs[k, m] *= weight
                        products[PAIR_OF[k, m], row, x] += pairs[k, m]
                        sides[k] += pairs[k, m] * phi[m]
                        if m < k:
                            sides[m] += pairs[k, m] * phi[k]
                for k in range(several):
                    products[SIDE_OF[k], row, x] += sides[k]
                products[14, row, x] += squares
                products[15, row, x] += used - 1.0
                products[16, row, x] += 1.0
                products[17, row, x] += weight * (along * along + down * down)

    return compiled


_ADD_PRODUCTS = {several: _compiled_products(several) for several in (STEADY, ACCELERATED)}


def add_products(
    view: View,
    fields: NDArray[np.float64],
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    first_row: int,
    least: int,
    variance: tuple[float, float],
    products: NDArray[np.float64],
    rows: tuple[int, int],
) -> None:
    """Compute the pixels' own normal equations for disparity and velocity, with the texture as an unknown.

    With a_i = ∇T · ∂x'_i / ∂(d, q), its mean over the images ā, and the texture T as the images' mean:
    M = Σ_i (a_i - ā)(a_i - ā)ᵀ and b = Σ_i (a_i - ā)(T - g_i). All squares and products of grey values are divided by
    the variance of their noise, relative to that of a mean grey value.

    Parameters
    ----------
    view, fields, warped, gradient, first_row, rows
        As of `warp_rows`.
    least
        Pixels that fewer images show are left out.
    variance
        Relative variance at a grey value of zero, and what it grows by per grey value.
    products
        Sums to be added to, shape (22, rows, width): the 10 products of M, row by row above the diagonal, then the 4 of
        M (d, q) + b, then Σ_i (g_i - T)², the number of images less one, 1, |∇T|², and the 4 squares of b. If the
        acceleration is a field, shape (46, rows, width): behind these, the columns of M of a_X, a_Y and a_Z down to the
        diagonal, then the other 3 of M (d, q, a) + b, and the other 3 squares of b. Nothing is added where a pixel is
        left out.
    """
    _ADD_PRODUCTS[len(fields)](view, fields, warped, gradient, first_row, least, variance, products, rows)


@numba.njit(inline="always")
def is_pair(product: int) -> bool:
    """Tell whether a product is one of M."""
    return product < 10 or PRODUCTS <= product < SIDE_OF[STEADY]


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

    Parameters
    ----------
    warped, least, rows
        As of `add_products`.
    texture
        Output, shape (rows, width).
    """
    mean = np.empty(warped.shape[2])
    for row in range(rows[0], rows[1]):
        mean_of_row(warped, row, least, mean)
        texture[row] = mean

"""Kernels for the normal equations of single pixels, including gain and offset of the images."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, ImageView, place_of

__all__ = [
    "ALL_PRODUCTS",
    "LEAST_VARIANCE",
    "PAIR_OF",
    "PRODUCTS",
    "SIDE_OF",
    "SQUARE_OF",
    "add_products",
    "correct_brightness",
    "is_pair",
]


_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

PRODUCTS, ALL_PRODUCTS = 22, 46
"""Numbers of maps that `add_products` fills: for the four fields d and q, and with those of the acceleration."""
LEAST_VARIANCE = 0.01
"""Lower limit of the relative noise variance."""


def _pairs() -> NDArray[np.int64]:
    """Return the index of the product of each pair of fields."""
    found = np.zeros((7, 7), dtype=np.int64)
    found[np.triu_indices(STEADY)] = np.arange(10)
    first = PRODUCTS
    for k in range(STEADY, 7):
        found[: k + 1, k] = first + np.arange(k + 1)
        first += k + 1
    return np.maximum(found, found.T)


PAIR_OF = _pairs()
"""Index of the product of each pair of fields, shape (7, 7)."""
SIDE_OF = np.array([10, 11, 12, 13, 40, 41, 42])
"""Index of the component of M (d, q, a) + b of each field."""
SQUARE_OF = np.array([18, 19, 20, 21, 43, 44, 45])
"""Index of the square of b of each field."""


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
                # Noise does not vanish in dark pixels.
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
    view: ImageView,
    fields: NDArray[np.float64],
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    first_row: int,
    least: int,
    variance: tuple[float, float],
    products: NDArray[np.float64],
    rows: tuple[int, int],
) -> None:
    """Compute the normal equations of each pixel for disparity and velocity, with the texture as an unknown.

    With a_i = ∇T · ∂x'_i / ∂(d, q), its mean over the images ā, and the mean image as texture T:
    M = Σ_i (a_i - ā)(a_i - ā)ᵀ and b = Σ_i (a_i - ā)(T - g_i). All squares and products of grey values are divided by
    the variance of their noise, relative to that of a mean grey value.

    ``products``: Sums to increment, shape (22, rows, width): the 10 products of M, row by row above the diagonal,
      then the 4 of M (d, q) + b, then Σ_i (g_i - T)², the number of images less one, 1, |∇T|², and the 4 squares of b.
      If the acceleration is a field, shape (46, rows, width): also the columns of M of a_X, a_Y and a_Z down to the
      diagonal, then the other 3 of M (d, q, a) + b, and the other 3 squares of b. Invalid pixels are skipped.
    """
    _ADD_PRODUCTS[len(fields)](view, fields, warped, gradient, first_row, least, variance, products, rows)


@numba.njit(inline="always")
def is_pair(product: int) -> bool:
    """Return whether a product is an element of M."""
    return product < 10 or PRODUCTS <= product < SIDE_OF[STEADY]


@_jit
def _brightness(image: Any, texture: Any, some: Any, window: Any, y: int, step: int, sums: Any, nodes: Any) -> None:
    """Write gain and offset, estimated in the window, at every n-th column of a row, and at the last."""
    height, width = image.shape
    reach = window.shape[0] // 2
    sums[:] = 0.0
    for v in range(max(y - reach, 0), min(y + reach + 1, height)):
        if not some[v]:
            continue
        weight = window[v - y + reach]
        for x in range(width):
            g, h = image[v, x], texture[v, x]
            known = not (np.isnan(g) or np.isnan(h))
            w = weight if known else np.float32(0.0)
            a, b = (g, h) if known else (np.float32(0.0), np.float32(0.0))
            at = x + reach
            sums[0, at] += w
            sums[1, at] += w * a
            sums[2, at] += w * b
            sums[3, at] += w * a * b
            sums[4, at] += w * b * b
    for node in range(nodes.shape[1]):
        x = min(node * step, width - 1)
        n, g, h, gh, hh = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(2 * reach + 1):
            weight = window[j]
            n += weight * sums[0, x + j]
            g += weight * sums[1, x + j]
            h += weight * sums[2, x + j]
            gh += weight * sums[3, x + j]
            hh += weight * sums[4, x + j]
        spread = hh * n - h * h
        gain = (gh * n - g * h) / spread if spread > 1e-6 * h * h + 1e-12 else 1.0
        nodes[0, node] = gain if gain > 0.1 else np.nan
        nodes[1, node] = (g - gain * h) / n if n > 0.0 else np.nan


@_jit
def correct_brightness(
    image: NDArray[np.float32],
    texture: NDArray[np.float32],
    window: NDArray[np.float32],
    step: int,
    first_row: int,
    out: NDArray[np.float32],
) -> None:
    """Remove gain and offset of an image relative to the texture, estimated in the window around every n-th pixel.

    Gain and offset are interpolated linearly; they vary over the width of a window.

    ``image``: Warped grey values, NaN where invalid, shape (rows, width).
    ``texture``: The texture, NaN where invalid, of the same shape.
    ``window``: Weights along either axis, shape (2 r + 1,).
    """
    height, width = image.shape
    sums = np.empty((5, width + window.shape[0] - 1), dtype=np.float32)
    count = (width - 1 + step - 1) // step + 1
    above, below = np.empty((2, count)), np.empty((2, count))
    some = np.empty(height, dtype=np.bool_)
    for y in range(height):
        some[y] = not np.isnan(texture[y]).all()
    top = 0
    _brightness(image, texture, some, window, top, step, sums, above)
    while True:
        bottom = min(top + step - (top + first_row) % step, height - 1)
        _brightness(image, texture, some, window, bottom, step, sums, below)
        for y in range(top, bottom + 1 if bottom == height - 1 else bottom):
            if not some[y]:
                out[y] = np.nan
                continue
            down = (y - top) / (bottom - top) if bottom > top else 0.0
            for x in range(width):
                node = min(x // step, count - 2) if count > 1 else 0
                other = min(node + 1, count - 1)
                gap = min(other * step, width - 1) - node * step
                across = (x - node * step) / gap if gap > 0 else 0.0
                left, right = (1.0 - across) * (1.0 - down), across * (1.0 - down)
                low_left, low_right = (1.0 - across) * down, across * down
                gain = left * above[0, node] + right * above[0, other]
                gain += low_left * below[0, node] + low_right * below[0, other]
                offset = left * above[1, node] + right * above[1, other]
                offset += low_left * below[1, node] + low_right * below[1, other]
                out[y, x] = (image[y, x] - offset) / gain
        if bottom == height - 1:
            return
        top = bottom
        above[:] = below

"""Kernel for the pixels' own normal equations."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, View, place_of

__all__ = [
    "ALL_PRODUCTS",
    "LEAST_VARIANCE",
    "PAIR_OF",
    "PRODUCTS",
    "SIDE_OF",
    "SQUARE_OF",
    "add_products",
    "is_pair",
]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

PRODUCTS, ALL_PRODUCTS = 22, 46
"""Maps that `add_products` fills: with the four fields d and q, and with those of the acceleration too."""
LEAST_VARIANCE = 0.01
"""Relative variance of noise, at least."""


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

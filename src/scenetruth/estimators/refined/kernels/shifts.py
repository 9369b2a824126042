"""Kernel that tells by how much blocks of pixels are off in every image."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import mean_of_row

__all__ = ["SUMS", "add_shifts"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

SUMS = 7
"""Sums that `add_shifts` fills."""


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
    """Sum up, over blocks of pixels, what each image and the images' mean T tell of a shift between them.

    An image that shows g where the mean shows T is to be moved by the δ that minimises Σ (g + ∇T · δ - T)²: the
    solution of Σ ∇T ∇Tᵀ δ = Σ ∇T (T - g).

    Parameters
    ----------
    warped, gradient, least
        As of `products.add_products`.
    first_row
        Row of the image at which the arrays begin.
    block
        Edge of a block in px; blocks begin at row and column 0 of the image.
    sums
        Is added to: for every row of blocks, block and image the sums of T_x², T_x T_y, T_y², T_x (T - g), T_y (T - g),
        (T - g)² and 1, shape (rows of blocks, columns of blocks, n, 7).
    rows
        First and last + 1 of the rows of blocks to be summed up; they lie inside the arrays, as far as the image goes.
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

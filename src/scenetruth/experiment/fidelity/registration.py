"""Sub-pixel shifts of an image against the exact one, subset by subset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["shift_errors"]


def shift_errors(
    image: NDArray[np.float32] | NDArray[np.float64],
    exact: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    subset_px: int,
) -> NDArray[np.float64]:
    """Register an image to the exact one in square subsets that touch each other.

    A content that lies e to the right of where it should has the grey values exact(x - e), to first order
    exact - e d exact/dx. The least-squares solution for e, with analytic derivatives, is one Gauss-Newton step; the
    terms of second order that it leaves out change it by some e² over the wavelength: nothing, at the thousandths of a
    pixel found here. Gain and offset are not adjusted: what they could explain counts as error.

    Parameters
    ----------
    image
        The image, shape (height, width).
    exact
        What it should be.
    across, down
        Derivatives of ``exact`` per pixel to the right, and per pixel down.
    subset_px
        Edge of the subsets; what is left of rows and columns at the end is not used.

    Returns
    -------
    numpy.ndarray
        Shift (x, y) of the image's content in px, shape (rows, columns, 2), float64.
    """
    rows, columns = (side // subset_px for side in exact.shape)

    def sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
        used = values[: rows * subset_px, : columns * subset_px]
        return np.asarray(used.reshape(rows, subset_px, columns, subset_px).sum(axis=(1, 3)))

    difference = exact - image
    xx, xy, yy = sums(across * across), sums(across * down), sums(down * down)
    x, y = sums(across * difference), sums(down * difference)
    determinant = xx * yy - xy * xy
    return np.stack([(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant], axis=-1)

"""Kernel that interpolates single pixels from those around them."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["smooth_over"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@numba.njit(inline="always")
def _inside(n: Any, size: Any) -> Any:
    """Return a place within the image: beyond its ends, the image is mirrored at its last pixels."""
    n = abs(n)
    return max(2 * (size - 1) - n, 0) if n >= size else n


@_jit
def smooth_over(image: NDArray[np.float64], pixels: NDArray[np.int64], sweeps: int) -> None:
    """Bring some pixels to where the squared Laplacian of the image is least, the others being fixed.

    One pixel alone gets, after one sweep, what continues any polynomial of third degree: (8 a - 2 b - c) / 20 with the
    sums a over the four next to it, b over the four across the corners, c over the four two pixels away.

    Parameters
    ----------
    image
        Finite grey values, shape (y, x); these pixels are changed.
    pixels
        Rows and columns of the pixels, shape (n, 2).
    sweeps
        How often each is brought there in turn.
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

"""Images at lower resolutions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["averaged"]


def averaged(images: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return means over squares of pixels; what does not fill a square is left out.

    Parameters
    ----------
    images
        Shape (n, y, x).
    factor
        Edge of the squares in px.

    Examples
    --------
    >>> averaged(np.arange(10, dtype=np.float32).reshape(1, 2, 5), 2).tolist()
    [[[3.0, 5.0]]]
    """
    if factor == 1:
        return images
    count, height, width = (size // scale for size, scale in zip(images.shape, (1, factor, factor), strict=True))
    squares = images[:, : height * factor, : width * factor].reshape(count, height, factor, width, factor)
    return np.asarray(squares.mean(axis=(2, 4)), dtype=np.float32)

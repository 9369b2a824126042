"""Gain and offset of every image in blocks of pixels, from the pixels that the images agree on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import NOTHING_HIDDEN
from scenetruth.estimators.refined.kernels.warp import View, warp_rows
from scenetruth.estimators.threads import in_threads

__all__ = ["BLOCK_PX", "Brightness", "brightness_of_blocks", "even_brightness"]

BLOCK_PX = 32
"""Edge of a block."""
# A block needs so many pixels.
_LEAST = 64


class Brightness(NamedTuple):
    """What takes an image to the brightness of the images' mean: (grey value - offset) / gain, in blocks."""

    gain: NDArray[np.float32]
    """Gains, shape (n, rows of blocks, columns of blocks)."""
    offset: NDArray[np.float32]
    """Offsets in grey values, of the same shape."""


def even_brightness(count: int) -> Brightness:
    """Return that all images have the same brightness.

    Parameters
    ----------
    count
        Number of images.
    """
    return Brightness(np.ones((count, 1, 1), dtype=np.float32), np.zeros((count, 1, 1), dtype=np.float32))


def brightness_of_blocks(
    coefficients: NDArray[np.float32], view: View, fields: NDArray[np.float64], good: NDArray[np.bool_]
) -> Brightness:
    """Find the images' gains and offsets against their mean by regression in blocks.

    Parameters
    ----------
    coefficients, view, fields
        As of `warp_rows`.
    good
        Pixels that are asked, shape (y, x).

    Returns
    -------
    Brightness
        Blocks with too few pixels, or without contrast, have the values of the nearest that suffice.
    """
    count, height, width = coefficients.shape
    down, across = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    gain = np.full((count, down, across), np.nan, dtype=np.float32)
    offset = np.full_like(gain, np.nan)
    asked = np.where(good, fields, np.nan)

    def regress(block: int) -> None:
        first = block * BLOCK_PX
        rows = min(BLOCK_PX, height - first)
        warped = np.empty((count, rows, width), dtype=np.float32)
        warp_rows(
            coefficients, view, asked, NOTHING_HIDDEN, first, warped, np.empty((2, rows, width), np.float32), (0, rows)
        )
        for column in range(across):
            part = warped[:, :, column * BLOCK_PX : (column + 1) * BLOCK_PX].reshape(count, -1).astype(np.float64)
            part = part[:, np.isfinite(part).all(axis=0)]
            if part.shape[1] < _LEAST:
                continue
            texture = part.mean(axis=0)
            spread = texture - texture.mean()
            square = float(spread @ spread)
            if square > 0:
                gain[:, block, column] = part @ spread / square
                offset[:, block, column] = part.mean(axis=1) - gain[:, block, column] * texture.mean()

    in_threads(regress, range(down))
    known = np.isfinite(gain).all(axis=0) & (gain > 0.1).all(axis=0)
    if not known.any():
        return even_brightness(count)
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return Brightness(*(np.ascontiguousarray(values[:, nearest[0], nearest[1]]) for values in (gain, offset)))

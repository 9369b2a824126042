"""Gain and offset of every image in blocks of pixels, from the pixels that the images agree on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import NOTHING_HIDDEN
from scenetruth.estimators.refined.kernels.warp import View, warp_rows
from scenetruth.threads import in_threads

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
    coefficients: NDArray[np.float32],
    view: View,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8],
    good: NDArray[np.bool_],
) -> Brightness:
    """Find the images' gains and offsets against their mean by regression in blocks.

    Parameters
    ----------
    coefficients, view, fields, bad
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
    # Images that are left out as a whole have no brightness.
    used = ~bad.all(axis=(1, 2)) if bad.shape[0] > 0 else np.ones(count, dtype=np.bool_)

    def regress(block: int) -> None:
        first = block * BLOCK_PX
        rows = min(BLOCK_PX, height - first)
        warped = np.empty((count, rows, width), dtype=np.float32)
        gradient = np.empty((2, rows, width), dtype=np.float32)
        warp_rows(coefficients, view, asked, NOTHING_HIDDEN, bad, first, warped, gradient, (0, rows))
        for column in range(across):
            part = warped[:, :, column * BLOCK_PX : (column + 1) * BLOCK_PX].reshape(count, -1).astype(np.float64)
            found = _in_block(part[used], some_bad=bad.shape[0] > 0)
            if found is not None:
                gain[used, block, column], offset[used, block, column] = found

    in_threads(regress, range(down))
    gain[~used], offset[~used] = 1.0, 0.0
    known = np.isfinite(gain).all(axis=0) & (gain > 0.1).all(axis=0)
    if not known.any():
        return even_brightness(count)
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return Brightness(*(np.ascontiguousarray(values[:, nearest[0], nearest[1]]) for values in (gain, offset)))


def _in_block(values: NDArray[np.float64], *, some_bad: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return gains and offsets of images against their mean, from grey values (n, pixels), NaN where unknown."""
    known = np.isfinite(values)
    # Pixels that all images show have one texture; if bad ones lie between, every image is asked where it is known.
    values = values[:, known.mean(axis=0) >= 0.5 if some_bad else known.all(axis=0)]
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    if counts.min(initial=values.shape[1]) < _LEAST:
        return None
    means = np.where(known, values, 0.0).sum(axis=1) / counts
    around = np.where(known, values - means[:, None], 0.0)
    texture = around.sum(axis=0) / known.sum(axis=0)
    # Over the pixels that each image shows.
    middle = known @ texture / counts
    squares = known @ texture**2 - counts * middle**2
    if squares.min(initial=np.inf) <= 0:
        return None
    gain = (around @ texture) / squares
    return gain, means - gain * (middle + means.mean())

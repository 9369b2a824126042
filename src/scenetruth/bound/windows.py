"""Sums of the pixels' information over windows that keep to one piece of surface."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.model import Model
from scenetruth.bound.products import pair_of

__all__ = ["Part", "Window", "parts_of", "window_weights"]

Map = NDArray[np.float64]
Window = Literal["gaussian", "even"]

# Gaussian windows reach this many times their standard deviation, as those of the methods do.
_CUT = 2.0
_POWERS = 3
# Rows of an image that are summed up at a time.
_ROWS = 128


def window_weights(window: Window, sigma_px: float) -> Map:
    """Return a window's weights along one axis, times the powers 0 to 2 of the distance.

    Parameters
    ----------
    window
        ``"gaussian"``: of standard deviation ``sigma_px``, cut off at twice that. ``"even"``: as wide as gives the same
        standard deviation, to the next odd number of pixels.
    sigma_px
        The standard deviation.

    Returns
    -------
    numpy.ndarray
        Shape (3, 2 r + 1); the largest weight is 1.
    """
    # n even weights have the variance (n² - 1) / 12.
    even = window == "even"
    reach = max(1, round((math.sqrt(12 * sigma_px**2 + 1) - 1) / 2) if even else math.ceil(_CUT * sigma_px))
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.ones_like(at) if even else np.exp(-0.5 * (at / sigma_px) ** 2)
    return np.asarray(weights * at ** np.arange(_POWERS)[:, None])


@dataclass(frozen=True, eq=False)
class Part:
    """Windows around some pixels: their sums.

    Parameters
    ----------
    rows, columns
        The pixels, each of shape (n,).
    sums
        Sums of products over the windows, by the pair of fields and the powers of the distance along x and y, each of
        shape (n,).
    squares
        The same with squared weights.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    sums: dict[tuple[int, int, int], Map]
    squares: dict[tuple[int, int, int], Map]


def parts_of(products: Map, pieces: NDArray[np.int64], weights: Map, model: Model, every_px: int) -> Iterator[Part]:
    """Sum up products over the windows around pixels, piece by piece and band by band.

    Parameters
    ----------
    products
        As of `products_of`, shape (pairs, y, x).
    pieces
        The piece of surface that each pixel belongs to; windows take pixels of their centre's piece only.
    weights
        As of `window_weights`.
    model
        Tells which powers of the distance are needed.
    every_px
        Only pixels in each n-th row and column are wanted.
    """
    from scipy.ndimage import find_objects

    reach = weights.shape[1] // 2
    # The square of a weight times a power is not the power of the squared weight.
    squared = weights[0] * weights
    for number, box in enumerate(find_objects(pieces + 1)):
        if box is None:
            continue
        top, bottom, left, right = box[0].start, box[0].stop, box[1].start, box[1].stop
        for first in range(top, bottom, _ROWS):
            last = min(first + _ROWS, bottom)
            around = slice(max(first - reach, top), min(last + reach, bottom))
            mask = pieces[around, left:right] == number
            wanted = np.zeros_like(mask)
            above = around.start
            rows = slice(first + (-first) % every_px - above, last - above, every_px)
            columns = slice((-left) % every_px, None, every_px)
            wanted[rows, columns] = mask[rows, columns]
            if not wanted.any():
                continue
            at = np.nonzero(wanted[rows, columns])
            inside = np.where(mask, products[:, around, left:right], 0.0)
            sums, squares = (_sums(inside, each, model, (rows, columns), at) for each in (weights, squared))
            y, x = np.nonzero(wanted)
            yield Part(y + above, x + left, sums, squares)


def _sums(
    products: Map, weights: Map, model: Model, chosen: tuple[slice, slice], at: tuple[NDArray[np.int64], ...]
) -> dict[tuple[int, int, int], Map]:
    """Sum up products around chosen rows and columns, and of these at some places."""
    from scipy.ndimage import correlate1d

    found = {}
    for (k, m), n in pair_of(model.fields).items():
        degree = model.degree_of(k) + model.degree_of(m)
        for j in range(degree + 1):
            along = correlate1d(products[n], weights[j], axis=1, mode="constant")[:, chosen[1]]
            for i in range(degree + 1 - j):
                both = correlate1d(along, weights[i], axis=0, mode="constant")[chosen[0]]
                found[n, j, i] = np.asarray(both[at])
    return found

"""Warped images and the normal equations of their pixels, for some rows at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.cameras.shifts import Shifts
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.kernels.brightness import correct_brightness
from scenetruth.estimators.refined.kernels.products import ALL_PRODUCTS, PRODUCTS, add_products
from scenetruth.estimators.refined.kernels.warp import STEADY, View, mean_texture, warp_rows
from scenetruth.threads import in_threads

__all__ = ["NOTHING_HIDDEN", "Band", "around", "bands", "pieces", "window_weights"]

# Bytes of warped images that are kept at a time, rows that a thread takes at a time, and rows of a band at least.
_SCRATCH_BYTES, _ROWS, _LEAST_BAND = 192e6, 16, 32
# Windows reach this many times their standard deviation.
_CUT = 2.0

NOTHING_HIDDEN = np.zeros((0, 0, 0), dtype=np.uint8)

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Band:
    """Normal equations of some rows."""

    products: Map
    """As of `add_products`, shape (22 or 46, rows, width)."""
    first: int
    """Row of the image at which they begin."""
    top: int
    """The first row whose windows lie inside them, as far as the image goes."""
    bottom: int
    """The row behind the last."""


def window_weights(sigma_px: float) -> Map:
    """Return the window's weights and their squares along one axis, times the powers 0 to 4 of the distance.

    Parameters
    ----------
    sigma_px
        Standard deviation of the Gaussian window.

    Returns
    -------
    numpy.ndarray
        Shape (2, 5, 2 r + 1).
    """
    reach = math.ceil(_CUT * sigma_px)
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.exp(-0.5 * (at / sigma_px) ** 2)
    weights /= weights.sum()
    powers = at ** np.arange(5)[:, None]
    return np.stack([weights * powers, weights**2 * powers])


def around(where: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return the pixels that lie within so many rows and columns of some.

    Parameters
    ----------
    where
        Those pixels, shape (y, x).
    reach
        How many rows and columns.
    """
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(where, 2 * reach + 1))


def bands(
    images: Images,
    fields: Map,
    sigma_px: float,
    *,
    gains: bool,
    least_share: float = 0.5,
    hidden: NDArray[np.uint8] = NOTHING_HIDDEN,
    shifts: Shifts | None = None,
) -> Iterator[Band]:
    """Warp all images by what is known of every pixel, and yield the pixels' normal equations band by band.

    Parameters
    ----------
    images
        The images.
    fields
        As of `warp_rows`.
    sigma_px
        Standard deviation of the windows that will be put together, and of those in which brightness is found.
    gains
        Whether every image has a gain and an offset of its own.
    least_share
        Pixels that fewer of the images show are left out.
    hidden
        In which images pixels are hidden, as of `visibility.hide`.
    shifts
        Is added to, if given.
    """
    height, width = images.shape
    view = images.view()
    window = window_weights(sigma_px)[0, 0]
    reach = len(window) // 2
    least = max(2, math.ceil(least_share * images.count))
    bad = images.bad_stack()
    stacks = [images.stack(channel) for channel in range(images.channels)]
    fields = np.ascontiguousarray(fields)
    at_a_time = int(_SCRATCH_BYTES / (8 * len(view.s) * width)) - 4 * reach
    size = max(at_a_time, _LEAST_BAND)
    for top in range(0, height, size):
        bottom = min(top + size, height)
        # Windows reach beyond the band, and so do those of the gains at their pixels.
        step = _brightness_step(window)
        first, end = max(top - 2 * reach - step, 0), min(bottom + 2 * reach + step, height)
        products = np.zeros((PRODUCTS if len(fields) == STEADY else ALL_PRODUCTS, end - first, width))
        for stack in stacks:
            count = end - first
            brightness = window if gains else None
            even, gradient = _channel(stack, view, fields, hidden, bad, first, brightness, least, count)
            add = partial(add_products, view, fields, even, gradient, first, least, images.variance, products)
            in_threads(add, pieces(0, count))
            if shifts is not None:
                shifts.add(even, gradient, least, first, (top, bottom))
        yield Band(products, first, top, bottom)


def pieces(first: int, end: int) -> list[tuple[int, int]]:
    """Return the rows that each thread takes in turn."""
    return [(row, min(row + _ROWS, end)) for row in range(first, end, _ROWS)]


def _channel(
    coefficients: NDArray[np.float32],
    view: View,
    fields: Map,
    hidden: NDArray[np.uint8],
    bad: NDArray[np.uint8],
    first: int,
    window: Map | None,
    least: int,
    rows: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return one channel's images for the rows of a band, as bright as their mean, and that one's gradient."""
    count, _, width = coefficients.shape
    warped = np.empty((count, rows, width), dtype=np.float32)
    gradient = np.empty((2, rows, width), dtype=np.float32)
    parts = pieces(0, rows)
    in_threads(partial(warp_rows, coefficients, view, fields, hidden, bad, first, warped, gradient), parts)
    if window is not None:
        texture, even = np.empty((rows, width), dtype=np.float32), np.empty_like(warped)
        in_threads(partial(mean_texture, warped, least, texture), parts)
        weights = window.astype(np.float32)
        step = _brightness_step(window)

        def correct(number: int) -> None:
            correct_brightness(warped[number], texture, weights, step, first, even[number])

        in_threads(correct, range(count))
        warped = even
    return warped, gradient


def _brightness_step(window: Map) -> int:
    """Return how far apart gain and offset are found: six times in a window's half width."""
    return max(1, len(window) // 12)

"""Warped images and the normal equations of their pixels, for a band of rows at a time.

And the evidence of single pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.pixel_equations import (
    ALL_PRODUCTS,
    PRODUCTS,
    add_products,
    correct_brightness,
)
from scenetruth.estimators.refined.kernels.warp import STEADY, ImageView, mean_texture, warp_rows
from scenetruth.estimators.refined.pose_corrections import ShiftObservations
from scenetruth.threads import in_threads

__all__ = [
    "NO_OCCLUSION",
    "PixelEvidence",
    "RowBand",
    "around",
    "bands",
    "local_gradient",
    "local_means",
    "pieces",
    "window_weights",
]


# Bytes of warped images that are kept at a time, rows that a thread takes at a time, and rows of a band at least.
_SCRATCH_BYTES, _ROWS, _LEAST_BAND = 192e6, 16, 32
# Windows reach this many times their standard deviation.
_CUT = 2.0

NO_OCCLUSION = np.zeros((0, 0, 0), dtype=np.uint8)

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RowBand:
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
    """Return the window's weights and their squares along one axis, times the powers 0 to 4 of the distance."""
    reach = math.ceil(_CUT * sigma_px)
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.exp(-0.5 * (at / sigma_px) ** 2)
    weights /= weights.sum()
    powers = at ** np.arange(5)[:, None]
    return np.stack([weights * powers, weights**2 * powers])


def around(where: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return the pixels that lie within so many rows and columns of some.

    ``where``: Those pixels, shape (y, x).
    """
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(where, 2 * reach + 1))


def bands(
    images: ImageStack,
    fields: Map,
    sigma_px: float,
    *,
    gains: bool,
    least_share: float = 0.5,
    hidden: NDArray[np.uint8] = NO_OCCLUSION,
    shifts: ShiftObservations | None = None,
) -> Iterator[RowBand]:
    """Warp all images by what is known of every pixel, and yield the pixels' normal equations band by band."""
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
        yield RowBand(products, first, top, bottom)


def pieces(first: int, end: int) -> list[tuple[int, int]]:
    """Return the rows that each thread takes in turn."""
    return [(row, min(row + _ROWS, end)) for row in range(first, end, _ROWS)]


def _channel(
    coefficients: NDArray[np.float32],
    view: ImageView,
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


# Pixels are judged with their neighbours, in a Gaussian window of this standard deviation that is cut at 3 px.
_SIGMA_PX, _EVIDENCE_CUT = 1.0, 2.5
# Of the window, so much is known.
_LEAST = 0.3
_SQUARES, _FREEDOM, _KNOWN, _GRADIENT = 14, 15, 16, 17


def local_means(values: NDArray[Any]) -> NDArray[Any]:
    """Return the means over a pixel and its neighbours.

    ``values``: Values, shape (y, x).
    """
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, _SIGMA_PX, truncate=_EVIDENCE_CUT))


def local_gradient(products: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean square of the texture's gradient over a pixel and its neighbours, 0 where nothing is known."""
    known, gradient = local_means(products[_KNOWN]), local_means(products[_GRADIENT])
    return np.asarray(np.where(known > 0, gradient / np.where(known > 0, known, 1.0), 0.0))


@dataclass(frozen=True, eq=False)
class PixelEvidence:
    """What every pixel shows by itself."""

    square: NDArray[np.float32]
    """Mean square of what the images leave, per degree of freedom; infinite where they show nothing, shape (y, x)."""
    gradient: NDArray[np.float32]
    """Mean square of the texture's gradient, shape (y, x)."""

    @classmethod
    def blank(cls, shape: tuple[int, int]) -> PixelEvidence:
        """Return maps to be written."""
        return cls(np.full(shape, np.inf, dtype=np.float32), np.zeros(shape, dtype=np.float32))

    def chosen(self, where: NDArray[np.bool_], seen: PixelEvidence) -> PixelEvidence:
        """Return what another fit's pixels show where that is chosen, and these elsewhere.

        ``where``: Pixels where it is, shape (y, x).
        """
        return PixelEvidence(np.where(where, seen.square, self.square), np.where(where, seen.gradient, self.gradient))

    def put(self, band: RowBand) -> None:
        """Write the rows of a band."""
        inner = slice(band.top - band.first, band.bottom - band.first)
        squares, freedom, known = (local_means(band.products[n])[inner] for n in (_SQUARES, _FREEDOM, _KNOWN))
        rows = slice(band.top, band.bottom)
        with np.errstate(invalid="ignore", divide="ignore"):
            # Known counts the channels: more than one makes a window fuller than it is, which does no harm.
            self.square[rows] = np.where(known > _LEAST, squares / freedom, np.inf)
        self.gradient[rows] = local_gradient(band.products)[inner]

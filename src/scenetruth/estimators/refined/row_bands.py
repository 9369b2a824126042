"""Row bands: warped images, normal equations of their pixels, and evidence of single pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
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
from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean
from scenetruth.estimators.refined.kernels.warp import STEADY, ImageView, mean_texture, warp_rows
from scenetruth.estimators.refined.pose_corrections import ShiftObservations
from scenetruth.threads import in_threads

__all__ = [
    "FIT_LIMITS",
    "NO_OCCLUSION",
    "FitLimits",
    "FrameSubset",
    "PixelEvidence",
    "RowBand",
    "around",
    "bands",
    "even_images",
    "local_gradient",
    "local_means",
    "mark_mostly",
    "pieces",
    "window_weights",
]


_ROWS, _LEAST_BAND = 16, 32  # number of rows per thread task, and smallest number of rows of a band
_LANES = 8  # the products of a pixel fill this number of lanes of vector instructions
_CUT = 2.0  # half-width of windows in standard deviations

NO_OCCLUSION = np.zeros((0, 0, 0), dtype=np.uint8)

Map = NDArray[np.float64]


@dataclass
class FitLimits:
    """Sizes that trade memory and time of the fit."""

    scratch_bytes: float = 96e6
    """Size of the warped images of a band of rows."""
    lattice_step: float = 0.7
    """Largest distance of windows in their standard deviations. The result of a Gaussian window has a power spectrum
    times exp(-4 π² σ² f²), of which 4e-9 is left at half the sampling frequency."""
    whole_pixels: float = 4e5
    """Largest number of pixels of an image that is estimated as a whole."""
    tile_pixels: float = 1.8e5
    """Largest number of pixels of a tile of larger images, with its margin."""


FIT_LIMITS = FitLimits()


@dataclass(frozen=True, eq=False)
class RowBand:
    """Normal equations of a band of rows."""

    products: Map
    """Products of `add_products`, shape (22 or 46, rows, width)."""
    first: int
    """Image row at which they begin."""
    top: int
    """First row whose windows lie inside them, within the image."""
    bottom: int
    """Last such row + 1."""
    last: bool
    """Whether it is the last band."""
    of_subsets: Sequence[Map] = ()
    """Products of each subset of the frames, as `products`."""

    @cached_property
    def by_pixel(self) -> NDArray[np.float32]:
        """Products of each pixel together, shape (rows, width, 24 or 48): those of `products` and zeros."""
        count, rows, width = self.products.shape
        out = np.zeros((rows, width, -(-count // _LANES) * _LANES), dtype=np.float32)

        def copy(part: tuple[int, int]) -> None:
            out[part[0] : part[1], :, :count] = self.products[:, part[0] : part[1]].transpose(1, 2, 0)

        in_threads(copy, pieces(0, rows))
        return out

    @cached_property
    def gradient(self) -> Map:
        """Mean square gradient of the texture over a pixel and its neighbours, as `local_gradient`."""
        return local_gradient(self.products)


@dataclass(frozen=True, eq=False)
class FrameSubset:
    """Consecutive frames of a stack whose normal equations are required by themselves."""

    images: ImageStack
    fields: Map
    """d and q of every pixel, with the acceleration if its products are required, shape (4 or 7, y, x)."""
    frames: slice
    """Places of these images in the stack."""

    @property
    def products(self) -> int:
        """Number of products."""
        return PRODUCTS if len(self.fields) == STEADY else ALL_PRODUCTS


def window_weights(sigma_px: float) -> Map:
    """Return the window weights and their squares along one axis, times the powers 0 to 4 of the distance."""
    reach = math.ceil(_CUT * sigma_px)
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.exp(-0.5 * (at / sigma_px) ** 2)
    weights /= weights.sum()
    powers = at ** np.arange(5)[:, None]
    return np.stack([weights * powers, weights**2 * powers])


def around(where: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return the pixels within a distance, in rows and columns, of pixels in the mask ``where``."""
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(where, 2 * reach + 1))


def mark_mostly(
    flags: NDArray[np.bool_], tested: NDArray[np.bool_], size: int, least: float = 0.5
) -> NDArray[np.bool_]:
    """Return where more than a share of the tested neighbours is flagged.

    Statistics of a neighbourhood, unlike those of all pixels, do not depend on the tile.

    ``size``: Side length of the neighbourhood in px. ``least``: Share of flagged neighbours.
    """
    from scipy.ndimage import uniform_filter

    share, all_of_them = (uniform_filter(each.astype(np.float64), size) for each in (flags & tested, tested))
    return np.asarray(tested & (share > least * all_of_them))


def bands(
    images: ImageStack,
    fields: Map,
    sigma_px: float,
    *,
    gains: bool,
    least_share: float = 0.5,
    hidden: NDArray[np.uint8] = NO_OCCLUSION,
    shifts: ShiftObservations | None = None,
    behind: int = 0,
    subsets: Sequence[FrameSubset] = (),
) -> Iterator[RowBand]:
    """Warp all images by the current parameters, and yield the normal equations of the pixels band by band.

    Rows far from all pixels with finite fields are left out.

    ``behind``: Number of rows above a band whose windows lie inside it, too.
    ``subsets``: Further normal equations, of some frames alone.
    """
    height, width = images.shape
    view = images.view()
    window = window_weights(sigma_px)[0, 0]
    reach = len(window) // 2
    least = max(2, math.ceil(least_share * images.count))
    bad = images.bad_stack()
    stacks = [images.stack(channel) for channel in range(images.channels)]
    fields = np.ascontiguousarray(fields)
    of_pixel = 4 * len(view.s) + 8 * sum(each.products for each in subsets)
    at_a_time = int(FIT_LIMITS.scratch_bytes / (of_pixel * width)) - 4 * reach - behind
    size = max(at_a_time, _LEAST_BAND)
    rows = np.flatnonzero(np.isfinite(fields[0]).any(axis=1))
    begin, stop = (int(rows[0]), int(rows[-1]) + 1) if rows.size else (0, 0)
    begin, stop = max(begin - 2 * reach, 0), min(stop + 2 * reach, height)
    for top in range(begin, stop, size):
        bottom = min(top + size, stop)
        # Windows extend beyond the band, and so do those of the gains at their pixels.
        step = _brightness_step(window)
        first, end = max(top - behind - 2 * reach - step, 0), min(bottom + 2 * reach + step, height)
        products = np.zeros((PRODUCTS if len(fields) == STEADY else ALL_PRODUCTS, end - first, width))
        parts = [np.zeros((each.products, *products.shape[1:])) for each in subsets]
        for stack in stacks:
            count = end - first
            brightness = window if gains else None
            even, gradient = even_images(stack, view, fields, hidden, bad, first, brightness, least, count)
            add = partial(add_products, view, fields, even, gradient, first, least, images.variance, products)
            in_threads(add, pieces(0, count))
            for each, part in zip(subsets, parts, strict=True):
                fewest = max(2, math.ceil(least_share * each.images.count))
                own = each.images.view(), each.fields, even[each.frames], gradient, first, fewest
                in_threads(partial(add_products, *own, images.variance, part), pieces(0, count))
            if shifts is not None:
                shifts.add(even, gradient, least, first, (top, bottom))
        yield RowBand(products, first, top, bottom, bottom == stop, parts)


def pieces(first: int, end: int, step: int = 1) -> list[tuple[int, int]]:
    """Return the row ranges of the thread tasks, of rows of a lattice with a step."""
    size = max(_ROWS // step, 1)
    return [(row, min(row + size, end)) for row in range(first, end, size)]


def even_images(
    coefficients: list[NDArray[np.float32]],
    view: ImageView,
    fields: Map,
    hidden: NDArray[np.uint8],
    bad: list[NDArray[np.uint8]],
    first: int,
    window: Map | None,
    least: int,
    rows: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the images of one channel for the rows of a band, normalised to their mean, and its gradient."""
    count, width = len(view.s), fields.shape[2]
    warped = np.empty((count, rows, width), dtype=np.float32)
    gradient = np.empty((2, rows, width), dtype=np.float32)
    parts = pieces(0, rows)
    in_threads(partial(warp_rows, coefficients, view, fields, hidden, bad, first, warped, gradient), parts)
    if len({*zip(view.s, view.s_y, strict=True)}) == 2:
        distance = np.abs(view.s) + np.abs(view.s_y)
        second = distance > distance.min()
        in_threads(partial(_remove_unseen_by, second, warped), parts)
    if window is not None:
        texture = np.empty((rows, width), dtype=np.float32)
        in_threads(partial(mean_texture, warped, least, texture), parts)
        weights = window.astype(np.float32)
        step = _brightness_step(window)

        def correct(number: int) -> None:
            correct_brightness(warped[number], texture, weights, step, first, warped[number])

        in_threads(correct, range(count))
    return warped, gradient


def _remove_unseen_by(second: NDArray[np.bool_], warped: NDArray[np.float32], part: tuple[int, int]) -> None:
    """Set pixels to NaN that no image of the second of two cameras shows.

    They agree with any disparity, so that a wrong disparity that moves a window out of these images would fit.
    """
    rows = warped[:, part[0] : part[1]]
    rows[:, np.isnan(rows[second]).all(axis=0)] = np.nan


def _brightness_step(window: Map) -> int:
    """Return the distance at which gain and offset are estimated: a third of the half-width of the window."""
    return max(1, round(len(window) / 6))


# Pixels are evaluated with their neighbours, in a Gaussian window of this standard deviation truncated at 3 px.
_SIGMA_PX, _EVIDENCE_CUT = 1.0, 2.5
# Smallest valid fraction of the window: at a straight edge, that of the first pixel without own values is 0.30.
_LEAST = 0.28
_SQUARES, _FREEDOM, _KNOWN, _GRADIENT = 14, 15, 16, 17


def local_means(values: NDArray[Any]) -> NDArray[Any]:
    """Return the means over a pixel and its neighbours, shape (y, x)."""
    return gaussian_mean(values, _SIGMA_PX, _EVIDENCE_CUT)


def local_gradient(products: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean square gradient of the texture over a pixel and its neighbours, 0 where invalid."""
    known, gradient = local_means(products[_KNOWN]), local_means(products[_GRADIENT])
    return np.asarray(np.where(known > 0, gradient / np.where(known > 0, known, 1.0), 0.0))


@dataclass(frozen=True, eq=False)
class PixelEvidence:
    """Residual and gradient of every pixel by itself."""

    square: NDArray[np.float32]
    """Mean square residual of the images per degree of freedom; infinite where invalid, shape (y, x)."""
    gradient: NDArray[np.float32]
    """Mean square gradient of the texture, shape (y, x)."""

    @classmethod
    def blank(cls, shape: tuple[int, int]) -> PixelEvidence:
        """Return initial maps to be filled."""
        return cls(np.full(shape, np.inf, dtype=np.float32), np.zeros(shape, dtype=np.float32))

    def chosen(self, where: NDArray[np.bool_], seen: PixelEvidence) -> PixelEvidence:
        """Return the evidence of another fit in the mask ``where``, else this evidence."""
        return PixelEvidence(np.where(where, seen.square, self.square), np.where(where, seen.gradient, self.gradient))

    def put(self, band: RowBand) -> None:
        """Write the rows of a band."""
        inner = slice(band.top - band.first, band.bottom - band.first)
        squares, freedom, known = (local_means(band.products[n])[inner] for n in (_SQUARES, _FREEDOM, _KNOWN))
        rows = slice(band.top, band.bottom)
        with np.errstate(invalid="ignore", divide="ignore"):
            # Valid pixels are counted per channel, which overestimates the coverage of several channels without harm.
            self.square[rows] = np.where(known > _LEAST, squares / freedom, np.inf)
        self.gradient[rows] = band.gradient[inner]

"""Tiles: parts of a large image that are estimated one after another, with the parts of all images that they need.

Every tile is estimated with a margin, in which windows are incomplete, and only its inner part is kept. The parts of
the other images are where the initial estimate displaces the tile, so that memory does not depend on the image size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import FramesNeeded, ImageStack, Region, filter_image
from scenetruth.estimators.refined.lattice import lattice_step
from scenetruth.estimators.refined.lens_distortion import distort
from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames
from scenetruth.estimators.refined.row_bands import FIT_LIMITS
from scenetruth.threads import in_threads

__all__ = [
    "RegionImages",
    "Tile",
    "choose_tiles",
    "margin_px",
    "spread_regions",
]

# Margin in standard deviations of a window. Windows end at 2; averages over twice their width, which test for changes
# and biases, have 1.2 % of their weight beyond it.
_MARGIN = 4.5
# Largest common multiple of the distances of windows and gains to which tiles are aligned, so that these are at the
# same pixels as in the whole image.
_ALIGNED = 16
# Pixels of a part of an image beyond the initial positions; and pixels beyond these, from which spline coefficients
# take 2e-9 of a grey value.
_REACH_PX, _FILTER_PX = 16, 24
# Fraction of initial positions on either side that are not trusted if they are far beyond the others, and pixels of the
# part for them, relative to its size.
_STRAY, _ROOM = 2e-3, 0.25
_OCCLUDING_PX = 200  # largest distance of points beyond a region that may occlude its points
_STEP_PX = 4  # distance of the pixels whose positions are computed
# Regions of a sample: their size, their distance, and their smallest and largest number along an axis.
_SAMPLE_PX, _SAMPLE_STEP_PX, _LEAST_SAMPLE, _MOST_SAMPLE = 96, 500, 2, 5

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Tile:
    """A tile with and without its margin."""

    region: Region
    """Pixels that are estimated."""
    inner: Region
    """Pixels that are kept."""

    @property
    def kept(self) -> tuple[slice, slice]:
        """Rows and columns of the region that are kept."""
        top, left = self.inner.top - self.region.top, self.inner.left - self.region.left
        return slice(top, top + self.inner.height), slice(left, left + self.inner.width)


def margin_px(sigma_px: float) -> int:
    """Return the margin of a tile: pixels whose windows, and averages over windows, may be incomplete."""
    unit = _alignment(sigma_px)
    return math.ceil(_MARGIN * sigma_px / unit) * unit


def choose_tiles(shape: tuple[int, int], sigma_px: float) -> list[Tile]:
    """Return the tiles of an image with the fewest pixels in all, margins included; a single one if the image is small.

    >>> [tile.region.width for tile in choose_tiles((480, 640), 6.0)]
    [640]
    """
    if shape[0] * shape[1] <= FIT_LIMITS.whole_pixels:
        whole = Region(0, 0, *shape, shape)
        return [Tile(whole, whole)]
    unit, margin = _alignment(sigma_px), margin_px(sigma_px)

    def cut(size: int) -> list[tuple[list[int], int, int]]:
        """Return edges, the largest part with margins, and the sum of all parts, for every number of parts."""
        found = []
        for count in range(1, max(1, size // (2 * margin)) + 1):
            edges = [*(round(size * n / count / unit) * unit for n in range(count)), size]
            parts = [min(last + margin, size) - max(first - margin, 0) for first, last in pairwise(edges)]
            found.append((edges, max(parts), sum(parts)))
        return found

    down, across = (cut(size) for size in shape)
    fitting = [(r[2] * c[2], r[0], c[0]) for r, c in product(down, across) if r[1] * c[1] <= FIT_LIMITS.tile_pixels]
    edges = min(fitting)[1:] if fitting else (down[-1][0], across[-1][0])
    return list(_tiles(edges, margin, shape))


def _tiles(edges: Sequence[list[int]], margin: int, shape: tuple[int, int]) -> Iterator[Tile]:
    spans = [list(pairwise(each)) for each in edges]
    for (top, bottom), (left, right) in product(*spans):
        first, begin = max(top - margin, 0), max(left - margin, 0)
        height, width = min(bottom + margin, shape[0]) - first, min(right + margin, shape[1]) - begin
        yield Tile(Region(first, begin, height, width, shape), Region(top, left, bottom - top, right - left, shape))


def _alignment(sigma_px: float) -> int:
    """Return the common multiple of the distances of windows, and of gains, and of rows; or of rows alone."""
    reach = math.ceil(2.0 * sigma_px)
    found = math.lcm(2, lattice_step(sigma_px), max(1, round((2 * reach + 1) / 6)))
    return found if found <= _ALIGNED else 2


def spread_regions(shape: tuple[int, int]) -> list[Region]:
    """Return regions spread over an image, corners included, as a sample of it."""
    sizes = [min(_SAMPLE_PX, size) for size in shape]
    starts = []
    for whole, size in zip(shape, sizes, strict=True):
        count = int(np.clip(round(whole / _SAMPLE_STEP_PX) + 1, _LEAST_SAMPLE, _MOST_SAMPLE))
        starts.append(np.unique(np.linspace(0, whole - size, count).round().astype(int)).tolist())
    return [Region(top, left, sizes[0], sizes[1], shape) for top, left in product(*starts)]


class RegionImages:
    """Parts of the images of a window of frames, which stays in memory as it is recorded.

    ``outline``: Images without coefficients, of the region that is the whole image.
    """

    def __init__(self, frames: DefectFilteredFrames, needed: FramesNeeded, outline: ImageStack) -> None:
        self._frames, self._first, self.outline = frames, needed.first, outline
        frames.hold(needed.first, needed.last)

    def frames(self) -> list[NDArray[Any]]:
        """Return the images as they are recorded, by frame, shape (channel, s, y, x) each."""
        return [self._frames.recorded(self._first + n) for n in range(len(self.outline.times))]

    def reference(self) -> NDArray[Any]:
        """Return the reference with defects filled, shape (channel, y, x)."""
        frame, camera = self.outline.reference()
        return self._frames.crop(self._first + frame, camera, slice(None), slice(None))

    def stack(self, region: Region, start: NDArray[Any], outline: ImageStack | None = None) -> ImageStack:
        """Return the images of a region, with the initial fields of the whole image, shape (4, y, x).

        ``outline``: Other frames and poses than those of all images.
        """
        fields = start[:, region.rows, region.columns].astype(np.float64)
        whole = self.outline if outline is None else outline
        centre = (whole.centre[0] - region.left, whole.centre[1] - region.top)
        lens = None if whole.lens is None else whole.lens.part(region.left, region.top, (region.height, region.width))
        part = replace(whole, region=region, centre=centre, lens=lens)
        starts, size = _extents(part, fields)
        cameras = len(part.positions)
        frames = self._first + np.flatnonzero(np.isin(self.outline.times, part.times))
        channels = self._frames.shape[0]
        coefficients = [np.empty((channels, cameras, *size), dtype=np.float32) for _ in frames]
        bad: list[NDArray[np.uint8] | None] = [None] * (len(frames) * cameras)

        def read(number: int) -> None:
            place, camera = divmod(number, cameras)
            box = tuple(slice(int(at), int(at) + count) for at, count in zip(starts[number], size, strict=True))
            wide = tuple(
                slice(max(each.start - _FILTER_PX, 0), min(each.stop + _FILTER_PX, most))
                for each, most in zip(box, region.whole, strict=True)
            )
            inner = tuple(
                slice(each.start - outer.start, each.stop - outer.start) for each, outer in zip(box, wide, strict=True)
            )
            images = self._frames.crop(int(frames[place]), camera, *wide)
            for channel, image in enumerate(images):
                coefficients[place][channel, camera] = filter_image(image, part.spline)[inner]
            bad[number] = self._frames.bad_crop(int(frames[place]), camera, *box)

        in_threads(read, range(len(frames) * cameras))
        flags: list[NDArray[np.uint8]] = []
        if any(each is not None for each in bad):
            nothing = np.zeros(size, dtype=np.uint8)
            every = [nothing if each is None else each for each in bad]
            flags = [np.stack(every[first : first + cameras]) for first in range(0, len(every), cameras)]
        origin = starts[:, ::-1].astype(np.float64) - [region.left, region.top]
        wide = _enlarged(region, _OCCLUDING_PX)
        wide = _enlarged(region, _spread_px(part, start[:, wide.rows, wide.columns]))
        beside = wide, start[:, wide.rows, wide.columns].astype(np.float64)
        return replace(part, coefficients=coefficients, bad=flags, origin=origin, beside=beside)


def _spread_px(images: ImageStack, fields: NDArray[Any]) -> int:
    """Return the largest difference of the displacements of two points in an image, of which one may occlude another.

    ``fields``: Of the region and its surroundings.
    """
    view = images.view()
    d, q_x, q_y, _ = fields[:, ::_STEP_PX, ::_STEP_PX].astype(np.float64)
    moved = [
        np.ptp(np.quantile(d * (t * q - s), (_STRAY, 1.0 - _STRAY)))
        for s, s_y, t in zip(view.s, view.s_y, view.t, strict=True)
        for q, s in ((q_x, s), (q_y, s_y))
    ]
    return min(math.ceil(float(max(moved))) + 2, _OCCLUDING_PX)


def _enlarged(region: Region, by: int) -> Region:
    """Return a region with more pixels on all sides, within the image."""
    top, left = max(region.top - by, 0), max(region.left - by, 0)
    bottom, right = (
        min(first + size + by, most)
        for first, size, most in (
            (region.top, region.height, region.whole[0]),
            (region.left, region.width, region.whole[1]),
        )
    )
    return Region(top, left, bottom - top, right - left, region.whole)


def _extents(images: ImageStack, fields: Map) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return row and column of the image at which the part of every image begins, shape (n, 2), and its size.

    ``images``: Of the region, without coefficients.
    """
    region = images.region
    assert region is not None
    height, width = region.height, region.width
    rows, columns = (np.unique(np.append(np.arange(0, size, _STEP_PX), size - 1)) for size in (height, width))
    down, across = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    view = images.whole_view()
    d, q_x, q_y, q_z = fields[:, down, across]
    x, y = across + region.left - view.centre_x, down + region.top - view.centre_y
    at = np.empty((len(view.s), 2, len(d)))
    for n, (s, s_y, t) in enumerate(zip(view.s, view.s_y, view.t, strict=True)):
        scale = 1.0 / (1.0 + t * d * q_z / view.focal)
        shown = np.stack([(x + d * (t * q_x - s)) * scale, (y + d * (t * q_y - s_y)) * scale])
        if images.lens is not None:
            shown = images.focal * distort(images.lens.coefficients, shown / images.focal)
        at[n] = shown[::-1] + np.array([view.centre_y, view.centre_x])[:, None]
    # Stray initial values extend a part by a fraction of its size only.
    room = _ROOM * np.array([height, width])
    ends = np.quantile(at, (_STRAY, 1.0 - _STRAY), axis=2)
    low = np.maximum(at.min(axis=2), ends[0] - room)
    high = np.minimum(at.max(axis=2), ends[1] + room)
    # The reference itself is required at all pixels of the region.
    frame, camera = images.reference()
    place = frame * len(images.positions) + camera
    low[place] = np.minimum(low[place], [region.top, region.left])
    high[place] = np.maximum(high[place], [region.top + height, region.left + width])
    whole = np.array(region.whole)
    first = np.clip(np.floor(low).astype(np.int64) - _REACH_PX, 0, whole)
    last = np.clip(np.ceil(high).astype(np.int64) + 1 + _REACH_PX, 0, whole)
    size = np.minimum(np.maximum((last - first).max(axis=0), [height, width]), whole)
    # All parts have the same size.
    start = np.minimum(first, whole - size)
    return start, (int(size[0]), int(size[1]))

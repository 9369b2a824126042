"""Cost volume: costs of all disparity hypotheses, semi-global aggregation in strips of rows, and best hypotheses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.estimators.plane_sweep.matching_kernels import (
    CENSUS_REACH,
    COST_OF_BIT,
    PHASES,
    aggregate,
    agreeing,
    census,
    fill_costs,
    shifted,
    winners,
)
from scenetruth.threads import in_threads

__all__ = [
    "ROWS",
    "BestHypothesis",
    "CameraRow",
    "Hypotheses",
    "RowStrip",
    "channel_mean",
    "choose_hypotheses",
    "downsample",
    "make_camera_row",
    "split_into_strips",
    "spread_hypotheses",
    "touching_census",
]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Disparity hypotheses in ascending order: equidistant runs with gaps between them."""

    values: NDArray[np.float64]
    """Disparity in columns per step of s, shape (k,)."""
    step: float
    """Distance of adjacent hypotheses within a run."""

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Whether a hypothesis follows the previous one without a gap, shape (k + 1,); False at both ends."""
        near = np.diff(self.values) < 1.5 * self.step
        return np.concatenate([[False], near, [False]])

    def at(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the disparities at fractional indices."""
        nearest = np.rint(place).astype(np.int64)
        return self.values[nearest] + (place - nearest) * self.step


def spread_hypotheses(ranges: Iterable[tuple[float, float]], step: float) -> Hypotheses:
    """Return hypotheses over ranges of disparity; overlapping ranges are merged.

    >>> found = spread_hypotheses([(3.0, 4.0), (0.0, 0.5), (0.4, 1.0)], 0.5)
    >>> found.values.tolist(), found.joined.tolist()
    ([0.0, 0.5, 1.0, 3.0, 3.5, 4.0], [False, True, True, False, True, True, False])
    """
    places: set[int] = set()
    for first, last in ranges:
        places |= set(range(int(np.floor(first / step)), int(np.ceil(last / step)) + 1))
    return Hypotheses(np.array(sorted(places), dtype=np.float64) * step, step)


@dataclass(frozen=True, eq=False)
class CameraRow:
    """Views of a row of cameras, without the reference; those with positive positions come first."""

    reference: int
    """Index of the reference among the images."""
    others: NDArray[np.int64]
    """Indices of the other views among the images."""
    positions: NDArray[np.float64]
    """Positions in steps: for disparity d, the point at x in the reference is at x - d s in a view at s."""

    @property
    def left(self) -> int:
        """Number of views in which points are further to the left than in the reference."""
        return int((self.positions > 0).sum())

    @property
    def nearest(self) -> NDArray[np.float64]:
        """Positions of the nearest view on each side."""
        sides = (self.positions[: self.left], self.positions[self.left :])
        return np.array([side[np.argmin(np.abs(side))] for side in sides if len(side) > 0])

    @property
    def farthest(self) -> float:
        """Distance of the farthest view."""
        return float(np.abs(self.positions).max())


def make_camera_row(positions: ArrayLike, sign: float) -> CameraRow:
    """Return the views of the cameras of a stage.

    >>> row = make_camera_row([-1, 0, 2], -1.0)
    >>> row.reference, row.others.tolist(), row.positions.tolist(), row.nearest.tolist()
    (1, [0, 2], [1.0, -2.0], [1.0, -2.0])
    """
    signed = np.asarray(positions, dtype=np.float64) * (1.0 if sign > 0 else -1.0)
    reference = int(np.argmin(np.abs(signed)))
    others = [n for n in np.argsort(-signed, kind="stable") if n != reference]
    return CameraRow(reference, np.array(others, dtype=np.int64), signed[others])


def channel_mean(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean over channels, the first axis; a single channel is not copied."""
    return images[0] if len(images) == 1 else np.asarray(images.mean(axis=0, dtype=np.float32))


def downsample(images: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return means over squares of ``factor`` by ``factor`` pixels; incomplete squares at the end are omitted.

    >>> downsample(np.arange(10, dtype=np.float32).reshape(1, 2, 5), 2).tolist()
    [[[3.0, 5.0]]]
    """
    if factor == 1:
        return images
    count, height, width = (size // scale for size, scale in zip(images.shape, (1, factor, factor), strict=True))
    squares = images[:, : height * factor, : width * factor].reshape(count, height, factor, width, factor)
    return np.asarray(squares.mean(axis=(2, 4)), dtype=np.float32)


ROWS = 120
"""Approximate number of rows of a strip, without margins."""
MARGIN = 24
"""Number of rows on either side shared with the adjacent strips."""


@dataclass(frozen=True)
class RowStrip:
    """A strip of image rows."""

    first: int
    last: int
    """First and last + 1 row, without margins."""
    top: int
    bottom: int
    """First and last + 1 row, with margins."""


def split_into_strips(height: int, rows: int = ROWS, margin: int = MARGIN) -> list[RowStrip]:
    """Return the strips of an image; their number is independent of the machine.

    >>> split_into_strips(240)[1]
    RowStrip(first=120, last=240, top=96, bottom=240)
    """
    count = max(1, round(height / rows))
    ends = [height * n // count for n in range(count + 1)]
    return [RowStrip(first, last, max(first - margin, 0), min(last + margin, height)) for first, last in pairwise(ends)]


Images = NDArray[np.float32]

# Penalties in units of the costs, tuned on scenes/rosette.yaml, leaf.yaml and cube.yaml, with their noise level and
# three times that level.
_STEP_PENALTY = 300.0  # of 1 px per step
_JUMP_PENALTY = 300.0
_EDGE = 15.0  # grey-value difference, in 255ths of the image range, that halves the penalty of a jump

_MOST_BITS = 15.0
_SQUARE_PX = 5

_STRIPS_BYTES = 350e6  # memory of the strips that are processed together
_LEAST_ROWS = 40  # smallest number of rows of a strip, less than half of which are its own


@dataclass(frozen=True, eq=False)
class BestHypothesis:
    """Best hypothesis of every pixel."""

    disparity: NDArray[np.float64]
    """Disparity in columns per step, shape (y, x)."""
    distinct: NDArray[np.float64]
    """Ratio of the lowest cost of any other hypothesis to the best cost, shape (y, x)."""
    bits: NDArray[np.float64]
    """Mean number of the 48 bits that differ, averaged over a square around the pixel, shape (y, x)."""
    agreed: NDArray[np.bool_]
    """Whether the nearest view on at least one side has the same best hypothesis at this point, shape (y, x)."""

    def sure(self, distinctness: float) -> NDArray[np.bool_]:
        """Return where the hypothesis is unique by this cost ratio, and a match by chance (18 to 24 bits) unlikely."""
        return self.agreed & (self.distinct > distinctness) & (self.bits < _MOST_BITS)


def choose_hypotheses(
    images: Images,
    row: CameraRow,
    hypotheses: Hypotheses,
    *,
    strip_rows: int = ROWS,
    memory_bytes: float = _STRIPS_BYTES,
) -> BestHypothesis:
    """Return the best hypothesis for every pixel of the reference, from grey values of shape (s, y, x).

    Pixels whose census touches an invalid pixel (NaN) are outside the images: views do not cover them, and the paths of
    the costs begin at their border.
    """
    from scipy import ndimage

    height, width = images.shape[1:]
    invalid = np.isnan(images)
    if invalid.any():
        images = np.stack([_filled(*each) for each in zip(images, invalid, strict=True)])
        invalid = touching_census(invalid)
    count = len(hypotheses.values)
    edges = _edges(images[row.reference], ~invalid[row.reference])
    quarters = np.rint(-hypotheses.values[:, None] * row.positions * PHASES).astype(np.int64)
    whole, phase = quarters // PHASES, quarters % PHASES
    steps = np.where(hypotheses.joined, _STEP_PENALTY * hypotheses.step, _JUMP_PENALTY)
    steps = np.maximum(np.rint(steps), 1).astype(np.uint16)
    jumps = np.maximum(_JUMP_PENALTY / (1 + np.arange(256) / _EDGE), 1.5 * steps.min()).astype(np.uint16)
    apart = row.farthest * hypotheses.step
    wide, tolerance = int(np.ceil(2 / apart)), int(np.ceil(1.5 / apart))
    shifts = np.rint(-hypotheses.values[:, None] * row.nearest).astype(np.int64)
    place = np.empty((height, width))
    distinct, bits = np.empty((2, height, width))
    agreed = np.zeros((height, width), dtype=np.bool_)

    def work(strip: RowStrip) -> None:
        rows = slice(strip.top, strip.bottom)
        part = images[:, rows]
        reference, views = _censuses(part, row)
        costs = np.empty((*reference.shape, count), dtype=np.uint8)
        fill_costs(reference, views, _coverage(invalid[:, rows], row), whole, phase, row.left, costs)
        del views
        outside = np.nonzero(invalid[row.reference, rows])
        costs[outside] = 0
        total = np.empty(costs.shape, dtype=np.uint16)
        aggregate(costs, edges[rows], steps, jumps, total)
        total[outside] = np.iinfo(np.uint16).max
        own = total[strip.first - strip.top : strip.last - strip.top]
        rows = slice(strip.first, strip.last)
        costs = costs[strip.first - strip.top : strip.last - strip.top]
        winners(own, costs, wide, place[rows], distinct[rows], bits[rows])
        for shift in shifts.T:
            agreeing(own, np.ascontiguousarray(shift), place[rows], tolerance, agreed[rows])

    per_row = width * (3 * count + 8 * (1 + PHASES * len(row.others)) + 12 * count / strip_rows)
    # Strips of wide images, or of many hypotheses, have fewer rows.
    strip_rows = min(strip_rows, max(int(memory_bytes / per_row) - 2 * MARGIN, _LEAST_ROWS))
    strips = split_into_strips(height, strip_rows)
    at_once = max(1, int(memory_bytes / (per_row * (strip_rows + 2 * MARGIN))))
    for n in range(0, len(strips), at_once):
        in_threads(work, strips[n : n + at_once])
    hidden = invalid[row.reference]
    if hidden.any() and not hidden.all():
        # As beyond the border of the image, for filters over neighbouring pixels.
        nearest = tuple(ndimage.distance_transform_edt(hidden, return_distances=False, return_indices=True))
        place, bits = place[nearest], bits[nearest]
    return BestHypothesis(
        hypotheses.at(place), distinct, ndimage.uniform_filter(bits / COST_OF_BIT, _SQUARE_PX), agreed
    )


def _censuses(images: Images, row: CameraRow) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return the census of the reference, and those of the other views at every phase."""
    shape = images.shape[1:]
    reference = np.empty(shape, dtype=np.uint64)
    census(images[row.reference], reference)
    views = np.empty((len(row.others), PHASES, *shape), dtype=np.uint64)
    moved = np.empty(shape, dtype=np.float32)
    for n, place in enumerate(row.others):
        for phase in range(PHASES):
            shifted(images[place], phase, moved)
            census(moved, views[n, phase])
    return reference, views


def touching_census(invalid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels, shape (..., y, x), whose census contains an invalid pixel."""
    from scipy import ndimage

    if not invalid.any():
        return invalid
    found = invalid.view(np.uint8)
    for axis in (-2, -1):
        found = ndimage.maximum_filter1d(found, 2 * CENSUS_REACH + 1, axis=axis, mode="constant")
    return np.asarray(found > 0)


def _filled(image: NDArray[np.float32], invalid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return an image whose invalid pixels have the mean of the others; no result depends on it."""
    return np.where(invalid, image[~invalid].mean() if not invalid.all() else np.float32(0.0), image)


def _coverage(invalid: NDArray[np.bool_], row: CameraRow) -> NDArray[np.uint64]:
    """Return where the other views cover a point, with and without a shift by a part of a pixel, see `fill_costs`."""
    if not invalid.any():
        return np.empty((0, 0, 0, 0), dtype=np.uint64)
    here = ~invalid[row.others]
    between = here.copy()
    # The cubic convolution reaches from one column before to two after.
    between[..., 1:] &= here[..., :-1]
    for ahead in (1, 2):
        between[..., :-ahead] &= here[..., ahead:]
    return np.where(np.stack([here, between], axis=1), np.uint64(2**64 - 1), np.uint64(0))


def _edges(image: Images, valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return grey values scaled to the range of an image, for the penalties of depth discontinuities."""
    low, high = np.percentile(image[valid] if valid.any() else image, (1, 99))
    scaled = (image - low) * (255 / max(high - low, 1e-30))
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)

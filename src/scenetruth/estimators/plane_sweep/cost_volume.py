"""Costs of all disparity hypotheses for all cameras, aggregated semi-globally in strips of rows.

The best hypothesis of every pixel.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.estimators.plane_sweep.matching_kernels import (
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
    "BestHypothesis",
    "CameraRow",
    "Hypotheses",
    "RowStrip",
    "choose_hypotheses",
    "downsample",
    "make_camera_row",
    "split_into_strips",
    "spread_hypotheses",
]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Disparities in rising order: runs of even steps, with gaps between them."""

    values: NDArray[np.float64]
    """Disparity in columns per step of s, shape (k,)."""
    step: float
    """Distance of two neighbours within a run."""

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Whether a hypothesis follows that before it without a gap, shape (k + 1,); the ends do not."""
        near = np.diff(self.values) < 1.5 * self.step
        return np.concatenate([[False], near, [False]])

    def at(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the disparities at places between hypotheses, counted from the first."""
        nearest = np.rint(place).astype(np.int64)
        return self.values[nearest] + (place - nearest) * self.step


def spread_hypotheses(ranges: Iterable[tuple[float, float]], step: float) -> Hypotheses:
    """Return hypotheses over ranges of disparity; ranges that meet become one.

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
    """The views of a row of cameras beside the reference; those on one side come first."""

    reference: int
    """Place of the reference among the images."""
    others: NDArray[np.int64]
    """Places of the other views among the images."""
    positions: NDArray[np.float64]
    """Their positions in steps: where disparity is d, a view at s sees at x - d s what the reference sees at x."""

    @property
    def left(self) -> int:
        """How many views see points further to the left than the reference does."""
        return int((self.positions > 0).sum())

    @property
    def nearest(self) -> NDArray[np.float64]:
        """The positions of the nearest view of each side."""
        sides = (self.positions[: self.left], self.positions[self.left :])
        return np.array([side[np.argmin(np.abs(side))] for side in sides if len(side) > 0])

    @property
    def farthest(self) -> float:
        """The distance of the farthest view."""
        return float(np.abs(self.positions).max())


def make_camera_row(positions: ArrayLike, sign: float) -> CameraRow:
    """Return the views of cameras along a stage.

    >>> row = make_camera_row([-1, 0, 2], -1.0)
    >>> row.reference, row.others.tolist(), row.positions.tolist(), row.nearest.tolist()
    (1, [0, 2], [1.0, -2.0], [1.0, -2.0])
    """
    signed = np.asarray(positions, dtype=np.float64) * (1.0 if sign > 0 else -1.0)
    reference = int(np.argmin(np.abs(signed)))
    others = [n for n in np.argsort(-signed, kind="stable") if n != reference]
    return CameraRow(reference, np.array(others, dtype=np.int64), signed[others])


def downsample(images: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return means over squares of pixels; what does not fill a square is left out.

    ``factor``: Edge of the squares in px.

    >>> downsample(np.arange(10, dtype=np.float32).reshape(1, 2, 5), 2).tolist()
    [[[3.0, 5.0]]]
    """
    if factor == 1:
        return images
    count, height, width = (size // scale for size, scale in zip(images.shape, (1, factor, factor), strict=True))
    squares = images[:, : height * factor, : width * factor].reshape(count, height, factor, width, factor)
    return np.asarray(squares.mean(axis=(2, 4)), dtype=np.float32)


ROWS = 120
"""Rows of a strip's own, about."""
MARGIN = 24
"""Rows that it shares with its neighbours on either side."""


@dataclass(frozen=True)
class RowStrip:
    """Some rows of an image."""

    first: int
    last: int
    """Rows of its own."""
    top: int
    bottom: int
    """Rows with the margins."""


def split_into_strips(height: int, rows: int = ROWS) -> list[RowStrip]:
    """Return the strips of an image; how many there are does not depend on the machine.

    >>> split_into_strips(240)[1]
    RowStrip(first=120, last=240, top=96, bottom=240)
    """
    count = max(1, round(height / rows))
    ends = [height * n // count for n in range(count + 1)]
    return [RowStrip(first, last, max(first - MARGIN, 0), min(last + MARGIN, height)) for first, last in pairwise(ends)]


Images = NDArray[np.float32]

# Penalties in the costs' unit, tuned on scenes/rosette.yaml, leaf.yaml and cube.yaml, with their noise and three times
# as much.
_STEP_PENALTY = 300.0  # of 1 px per step
_JUMP_PENALTY = 300.0
# Difference of grey values, in 255ths of the image's range, that halves the penalty of a jump.
_EDGE = 15.0

_MOST_BITS = 15.0
_SQUARE_PX = 5

# Memory of the strips in work.
_STRIPS_BYTES = 700e6


@dataclass(frozen=True, eq=False)
class BestHypothesis:
    """The best hypothesis of every pixel."""

    disparity: NDArray[np.float64]
    """In columns per step, shape (y, x)."""
    distinct: NDArray[np.float64]
    """How many times as much any other answer costs, shape (y, x)."""
    bits: NDArray[np.float64]
    """Mean number of the 48 bits that differ, over a square around the pixel, shape (y, x)."""
    agreed: NDArray[np.bool_]
    """Whether the nearest view on one side at least would choose the same where it sees the point, shape (y, x)."""

    def sure(self, distinctness: float) -> NDArray[np.bool_]:
        """Mark pixels at which any other hypothesis costs so many times as much, and chance does not explain the best.

        Of unrelated neighbourhoods, 24 bits differ; the best of many hypotheses finds about 18.
        """
        return self.agreed & (self.distinct > distinctness) & (self.bits < _MOST_BITS)


def choose_hypotheses(images: Images, row: CameraRow, hypotheses: Hypotheses) -> BestHypothesis:
    """Choose among hypotheses for every pixel of the reference.

    ``images``: Grey values, shape (s, y, x).
    """
    from scipy import ndimage

    height, width = images.shape[1:]
    count = len(hypotheses.values)
    edges = _edges(images[row.reference])
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
        fill_costs(reference, views, whole, phase, row.left, costs)
        del views
        total = np.empty(costs.shape, dtype=np.uint16)
        aggregate(costs, edges[rows], steps, jumps, total)
        own = total[strip.first - strip.top : strip.last - strip.top]
        rows = slice(strip.first, strip.last)
        costs = costs[strip.first - strip.top : strip.last - strip.top]
        winners(own, costs, wide, place[rows], distinct[rows], bits[rows])
        for shift in shifts.T:
            agreeing(own, np.ascontiguousarray(shift), place[rows], tolerance, agreed[rows])

    per_row = width * (3 * count + 8 * (1 + PHASES * len(row.others)) + 12 * count / ROWS)
    strips = split_into_strips(height)
    at_once = max(1, int(_STRIPS_BYTES / (per_row * (ROWS + 2 * MARGIN))))
    for n in range(0, len(strips), at_once):
        in_threads(work, strips[n : n + at_once])
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


def _edges(image: Images) -> NDArray[np.uint8]:
    """Return grey values over the range of an image, in which jumps of depth are looked for."""
    low, high = np.percentile(image, (1, 99))
    scaled = (image - low) * (255 / max(high - low, 1e-30))
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)

"""Scene flow of every pixel of the reference from the adjacent frames and the disparity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.estimators.plane_sweep.cost_volume import ROWS, RowStrip, channel_mean, downsample, split_into_strips
from scenetruth.estimators.plane_sweep.matching_kernels import PHASES, census, shifted
from scenetruth.estimators.plane_sweep.motion_kernels import HALVES, NeighbourFrame, costs_of, search
from scenetruth.threads import in_threads

__all__ = ["MotionResult", "sweep_motion"]

Map = NDArray[np.float64]

# Largest flow searched, in columns per frame.
_FARTHEST = 16
_COARSEST = 4
# Number of parallel parts of the exhaustive search.
_PARTS = 4
_LEAST_SIZE = 32
# Random search: sweeps, random changes in each, and initial change of flow in columns, at the lowest resolution,
# at those between, at the full one, and after the median.
_SEARCH, _MIDDLE_SEARCH, _FINE_SEARCH, _LAST_SEARCH = (6, 3, 1.0), (4, 3, 0.5), (4, 1, 0.5), (1, 3, 0.125)
# Bits per px of difference from a neighbour; px above which the penalty is constant; and columns per step above which a
# neighbour belongs to another surface.
_SMOOTH = (0.5, 2.0, 1.0)
_SQUARE_PX = 5
_MARGIN = 8  # rows shared by adjacent strips
# Memory of the census of a strip without margins, its smallest number of rows, and number of strips processed together.
_STRIP_BYTES, _LEAST_ROWS, _AT_ONCE = 50e6, 32, 4
# A flow is valid if flows at this distance have this cost ratio, with ten bits added to both costs.
_BESIDE_PX, _DISTINCT, _FLOOR_BITS, _MOST_BITS = 2.0, 1.4, 10.0, 15.0
_LEAST_DISPARITY = 1e-3


@dataclass(frozen=True, eq=False)
class MotionResult:
    """Result of the motion search."""

    velocity: Map
    """Velocity in baselines per frame (X, Y, Z), finite, shape (3, y, x); for one camera, flow in columns per frame and
    0."""
    known: NDArray[np.bool_]
    """Validity mask: the match is unique, shape (y, x)."""


@dataclass(frozen=True, eq=False)
class _Level:
    """All images at one resolution."""

    factor: int
    reference: NDArray[np.float32]
    beside: list[NDArray[np.float32]]
    t: Map
    s: Map
    disparity: Map
    focal: float
    centre: tuple[float, float]


def sweep_motion(
    reference: NDArray[np.float32],
    beside: Sequence[NDArray[np.float32]],
    times: ArrayLike,
    positions: ArrayLike,
    disparity: Map | None,
    focal_length_px: float,
    centre: tuple[float, float],
    farthest: float = _FARTHEST,
) -> MotionResult:
    """Estimate the motion of the points in the reference image, up to 16 columns per frame or a smaller prior.

    ``reference``: Image of the estimated frame, finite, shape (channel, y, x). Channels are averaged.
    ``beside``: Images of all cameras in the adjacent frames, shape (channel, s, y, x) each.
    ``disparity``: Finite, in columns per step, shape (y, x); None for one camera, which determines flow only.
    ``farthest``: Largest motion searched, in columns per frame.
    """
    grey = np.ascontiguousarray(channel_mean(reference))
    others = [channel_mean(frame) for frame in beside]
    s, t = np.asarray(positions, dtype=np.float64), np.asarray(times, dtype=np.float64)
    if disparity is None:
        nearest = int(np.argmin(np.abs(s)))
        others, s = [frame[[nearest]] for frame in others], np.zeros(1)
        shown, focal = np.ones(grey.shape), np.inf
    else:
        sign = -1.0 if np.median(disparity) < 0 else 1.0
        shown, focal = sign * np.maximum(np.abs(disparity), _LEAST_DISPARITY), focal_length_px
    factor = _COARSEST
    while factor > 1 and min(grey.shape) // factor < _LEAST_SIZE:
        factor //= 2
    q, known = None, np.zeros(grey.shape, dtype=np.bool_)
    while factor >= 1:
        level = _level(grey, others, t, s, shown, (focal, *centre), factor)
        first = q is None
        if q is None:
            q = _exhaustive(level, farthest)
        else:
            sizes = zip(level.disparity.shape, q.shape[1:], strict=True)
            rows, columns = (np.minimum(np.arange(fine) // 2, coarse - 1) for fine, coarse in sizes)
            q = q[:, rows[:, None], columns]
        q, known = _searched(level, q, first=first)
        factor //= 2
    assert q is not None
    return MotionResult(q, known)


def separable_median(maps: Map) -> Map:
    """Return medians over 5 columns of medians over 5 rows, with border replication, of maps of shape (n, y, x)."""
    for axis in (1, 2):
        length = maps.shape[axis]
        indices = np.clip(np.arange(length + 4) - 2, 0, length - 1)
        padded = np.moveaxis(np.take(maps, indices, axis=axis), axis, 0)
        a, b, c, d, e = (padded[n : n + length] for n in range(5))
        low = np.maximum(np.minimum(a, b), np.minimum(c, d))
        high = np.minimum(np.maximum(a, b), np.maximum(c, d))
        middle = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
        maps = np.ascontiguousarray(np.moveaxis(middle, 0, axis))
    return maps


def _level(
    grey: NDArray[np.float32],
    others: list[NDArray[np.float32]],
    t: Map,
    s: Map,
    disparity: Map,
    camera: tuple[float, float, float],
    factor: int,
) -> _Level:
    focal, x, y = camera
    small = downsample(grey[None], factor)[0]
    middle = factor // 2
    shown = disparity[middle::factor, middle::factor][: small.shape[0], : small.shape[1]]
    shown = shown / factor if factor > 1 else shown
    offset = (factor - 1) / 2
    return _Level(
        factor,
        small,
        [downsample(frame, factor) for frame in others],
        t,
        s,
        np.ascontiguousarray(shown),
        focal / factor,
        ((x - offset) / factor, (y - offset) / factor),
    )


def _later(level: _Level, top: int, bottom: int) -> NeighbourFrame:
    """Return the census of a range of rows of all images."""
    rows = slice(top, bottom)
    part = [frame[:, rows] for frame in level.beside]
    shape = part[0].shape[1:]
    reference = np.empty(shape, dtype=np.uint64)
    census(np.ascontiguousarray(level.reference[rows]), reference)
    codes = np.empty((len(part), len(level.s), HALVES, HALVES, *shape), dtype=np.uint64)
    moved, turned = np.empty(shape, dtype=np.float32), np.empty(shape[::-1], dtype=np.float32)
    for frame, view in np.ndindex(codes.shape[:2]):
        for i, j in product(range(HALVES), repeat=2):
            shifted(np.ascontiguousarray(part[frame][view].T), i * PHASES // HALVES, turned)
            shifted(np.ascontiguousarray(turned.T), j * PHASES // HALVES, moved)
            census(moved, codes[frame, view, i, j])
    x, y = level.centre
    disparity = np.ascontiguousarray(level.disparity[rows])
    return NeighbourFrame(
        reference, codes, level.t, level.s, max(float(np.abs(level.s).max()), 1.0), disparity, level.focal, x, y - top
    )


def _exhaustive(level: _Level, farthest: float) -> Map:
    """Return the best motion by whole columns and rows, without motion in depth, from costs averaged over squares."""
    from scipy import ndimage

    later = _later(level, 0, level.reference.shape[0])
    # A coarse column that is partly within the range belongs to it.
    reach = math.ceil(farthest / level.factor)
    shape = level.reference.shape
    rest = np.zeros((3, *shape))
    every = list(product(range(-reach, reach + 1), repeat=2))
    if farthest < _FARTHEST:
        every = [(u, v) for u, v in every if math.hypot(u, v) <= max(farthest / level.factor, 1.0)]
    parts: dict[int, tuple[Map, Map]] = {}

    def work(part: int) -> None:
        best, found, costs = np.full(shape, np.inf), np.zeros((2, *shape)), np.empty(shape)
        for u, v in every[part::_PARTS]:
            costs_of(later, rest, float(u), float(v), costs)
            # Among motions of equal cost, the slowest.
            around = ndimage.uniform_filter(costs, _SQUARE_PX) + 1e-3 * np.hypot(u, v)
            better = around < best
            best[better] = around[better]
            found[:, better] = np.array([[u], [v]])
        parts[part] = best, found

    in_threads(work, range(_PARTS))
    which = np.argmin([parts[part][0] for part in range(_PARTS)], axis=0)
    flow = np.take_along_axis(np.stack([parts[part][1] for part in range(_PARTS)]), which[None, None], axis=0)[0]
    return np.stack([*(flow / level.disparity), np.zeros(shape)])


def _searched(level: _Level, start: Map, *, first: bool) -> tuple[Map, NDArray[np.bool_]]:
    """Return the improved motion, and its validity mask."""
    from scipy import ndimage

    q, known = start.copy(), np.zeros(level.reference.shape, dtype=np.bool_)
    beside = (_BESIDE_PX * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])).tolist()
    smooth = (_SMOOTH[0], _SMOOTH[1], _SMOOTH[2] / level.factor)
    chosen = _SEARCH if first else _FINE_SEARCH if level.factor == 1 else _MIDDLE_SEARCH

    def work(strip: RowStrip) -> None:
        later = _later(level, strip.top, strip.bottom)
        part = np.ascontiguousarray(start[:, strip.top : strip.bottom])
        search(later, part, *chosen, smooth, strip.first)
        part = separable_median(part)
        search(later, part, *_LAST_SEARCH, smooth, strip.first)
        own = slice(strip.first - strip.top, strip.last - strip.top)
        q[:, strip.first : strip.last] = part[:, own]
        if level.factor == 1:
            costs = np.empty((1 + len(beside), *later.reference.shape))
            for values, (u, v) in zip(costs, [[0.0, 0.0], *beside], strict=True):
                costs_of(later, part, u, v, values)
                ndimage.uniform_filter(values, _SQUARE_PX, output=values)
            clear = costs[1:].min(axis=0) + _FLOOR_BITS > _DISTINCT * (costs[0] + _FLOOR_BITS)
            known[strip.first : strip.last] = (clear & (costs[0] < _MOST_BITS))[own]

    height, width = level.reference.shape
    per_row = 8 * HALVES**2 * len(level.beside) * len(level.s) * width
    strips = split_into_strips(height, int(np.clip(_STRIP_BYTES / per_row, _LEAST_ROWS, ROWS)), _MARGIN)
    for n in range(0, len(strips), _AT_ONCE):
        in_threads(work, strips[n : n + _AT_ONCE])
    return q, known

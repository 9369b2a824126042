"""Scene flow of every pixel of the reference from the adjacent frames and the disparity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.estimators.plane_sweep.cost_volume import RowStrip, downsample, split_into_strips
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
# Random search: sweeps, and initial change of flow in columns; smaller after a search at a lower resolution.
_SWEEPS, _REACH = 6, 1.0
_FINE_SWEEPS, _FINE_REACH = 4, 0.5
# Bits per px of difference from a neighbour; px above which the penalty is constant; and columns per step above which a
# neighbour belongs to another surface.
_SMOOTH = (0.5, 2.0, 1.0)
_SQUARE_PX = 5
_MEDIAN_PX = 5
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
    beside: NDArray[np.float32]
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
    grey = np.ascontiguousarray(reference.mean(axis=0, dtype=np.float32))
    others = np.stack([frame.mean(axis=0, dtype=np.float32) for frame in beside])
    s, t = np.asarray(positions, dtype=np.float64), np.asarray(times, dtype=np.float64)
    if disparity is None:
        nearest = int(np.argmin(np.abs(s)))
        others, s = others[:, [nearest]], np.zeros(1)
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


def _level(
    grey: NDArray[np.float32],
    others: NDArray[np.float32],
    t: Map,
    s: Map,
    disparity: Map,
    camera: tuple[float, float, float],
    factor: int,
) -> _Level:
    focal, x, y = camera
    small = downsample(grey[None], factor)[0]
    flat = downsample(others.reshape(-1, *grey.shape), factor)
    middle = factor // 2
    shown = disparity[middle::factor, middle::factor][: small.shape[0], : small.shape[1]] / factor
    offset = (factor - 1) / 2
    return _Level(
        factor,
        small,
        flat.reshape(*others.shape[:2], *small.shape),
        t,
        s,
        np.ascontiguousarray(shown),
        focal / factor,
        ((x - offset) / factor, (y - offset) / factor),
    )


def _later(level: _Level, top: int, bottom: int) -> NeighbourFrame:
    """Return the census of a range of rows of all images."""
    rows = slice(top, bottom)
    part = level.beside[:, :, rows]
    shape = part.shape[2:]
    reference = np.empty(shape, dtype=np.uint64)
    census(np.ascontiguousarray(level.reference[rows]), reference)
    codes = np.empty((*part.shape[:2], HALVES, HALVES, *shape), dtype=np.uint64)
    moved, turned = np.empty(shape, dtype=np.float32), np.empty(shape[::-1], dtype=np.float32)
    for frame, view in np.ndindex(part.shape[:2]):
        for i, j in product(range(HALVES), repeat=2):
            shifted(np.ascontiguousarray(part[frame, view].T), i * PHASES // HALVES, turned)
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

    q, height = start.copy(), level.reference.shape[0]
    beside = (_BESIDE_PX * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])).tolist()
    costs = np.empty((1 + len(beside), *level.reference.shape), dtype=np.float32)
    smooth = (_SMOOTH[0], _SMOOTH[1], _SMOOTH[2] / level.factor)

    def work(strip: RowStrip) -> None:
        later = _later(level, strip.top, strip.bottom)
        part = np.ascontiguousarray(start[:, strip.top : strip.bottom])
        sweeps, reach = (_SWEEPS, _REACH) if first else (_FINE_SWEEPS, _FINE_REACH)
        search(later, part, sweeps, reach, smooth, strip.first)
        part = np.stack([ndimage.median_filter(values, _MEDIAN_PX) for values in part])
        search(later, part, 1, 0.125, smooth, strip.first)
        own = slice(strip.first - strip.top, strip.last - strip.top)
        q[:, strip.first : strip.last] = part[:, own]
        if level.factor == 1:
            out = np.empty(later.reference.shape)
            for n, (u, v) in enumerate([[0.0, 0.0], *beside]):
                costs_of(later, part, u, v, out)
                costs[n, strip.first : strip.last] = out[own]

    in_threads(work, split_into_strips(height))
    if level.factor > 1:
        return q, np.zeros(level.reference.shape, dtype=np.bool_)
    for values in costs:
        ndimage.uniform_filter(values, _SQUARE_PX, output=values)
    clear = costs[1:].min(axis=0) + _FLOOR_BITS > _DISTINCT * (costs[0] + _FLOOR_BITS)
    return q, clear & (costs[0] < _MOST_BITS)

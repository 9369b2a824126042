"""Kernels of the motion search: random search with propagation to neighbouring pixels (PatchMatch)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.intrinsic_kernels import ones
from scenetruth.kernels import kernel

__all__ = ["HALVES", "UNSEEN_BITS", "NeighbourFrame", "costs_of", "search"]

_jit = kernel(error_model="numpy")

HALVES = 2
"""Number of subpixel positions at which images are sampled, along x and along y."""
UNSEEN_BITS = 16.0
"""Cost of a motion that leaves all images."""


class NeighbourFrame(NamedTuple):
    """The reference in the estimated frame, and the images of other frames in which its points are searched."""

    reference: NDArray[np.uint64]
    """Census of the reference, shape (y, x)."""
    images: NDArray[np.uint64]
    """Census of all images, shifted by half pixels up and to the left, shape (t, s, half y, half x, y, x)."""
    t: NDArray[np.float64]
    """Times of the images relative to the reference, in frames."""
    s: NDArray[np.float64]
    """Positions of the cameras in steps."""
    farthest: float
    """Largest camera distance from the reference in steps, at least 1."""
    disparity: NDArray[np.float64]
    """Disparity of the pixels of the reference in columns per step, shape (y, x)."""
    focal: float
    """Focal length in columns; infinite to exclude motion in depth."""
    centre_x: float
    """Column of the principal point."""
    centre_y: float
    """Row of the principal point."""


@numba.njit(inline="always")
def _cost(later: Any, y: int, x: int, qx: float, qy: float, qz: float) -> float:
    """Return the mean number of bits that differ for motion q, mainly of the better frame and of its better side."""
    height, width = later.reference.shape
    d = later.disparity[y, x]
    here = later.reference[y, x]
    best, sum_of_times, times = 1e9, 0.0, 0
    for n in range(len(later.t)):
        t = later.t[n]
        scale = 1.0 / (1.0 + t * d * qz / later.focal)
        there_x = 2.0 * ((x - later.centre_x + d * t * qx) * scale + later.centre_x)
        there_y = 2.0 * ((y - later.centre_y + d * t * qy) * scale + later.centre_y)
        if not (abs(there_x) < 1e6 and abs(there_y) < 1e6):
            continue
        row = int(np.floor(there_y + 0.5))
        if row < 0 or row > 2 * (height - 1):
            continue
        left = right = middle = 0
        lefts = rights = middles = 0
        for v in range(len(later.s)):
            s = later.s[v]
            column = int(np.floor(there_x - 2.0 * d * scale * s + 0.5))
            if column < 0 or column > 2 * (width - 1):
                continue
            differ = int(ones(here ^ later.images[n, v, row & 1, column & 1, row >> 1, column >> 1]))
            if s > 0:
                left, lefts = left + differ, lefts + 1
            elif s < 0:
                right, rights = right + differ, rights + 1
            else:
                middle, middles = middle + differ, middles + 1
        if lefts + rights + middles == 0:
            continue
        cost = 1e9
        if lefts + middles > 0:
            cost = (left + middle) / (lefts + middles)
        if rights + middles > 0:
            cost = min(cost, (right + middle) / (rights + middles))
        best = min(best, cost)
        sum_of_times += cost
        times += 1
    if times == 0:
        return UNSEEN_BITS
    # Points occluded in one frame are visible in the other; where both are visible, both should agree.
    return 0.75 * best + 0.25 * sum_of_times / times


@numba.njit(inline="always")
def _collect_neighbours(later: Any, q: Any, y: int, x: int, same: float, near: Any) -> int:
    """Write the motions of the four neighbours on the same surface; return their number."""
    height, width = later.reference.shape
    d, count = later.disparity[y, x], 0
    for n in range(4):
        i, j = y + (1 if n == 0 else (-1 if n == 1 else 0)), x + (1 if n == 2 else (-1 if n == 3 else 0))
        if 0 <= i < height and 0 <= j < width and abs(later.disparity[i, j] - d) < same:
            near[count, 0], near[count, 1], near[count, 2] = q[0, i, j], q[1, i, j], q[2, i, j]
            count += 1
    return count


@numba.njit(inline="always")
def _unlike(later: Any, y: int, x: int, motion: Any, near: Any, count: int, most: float) -> float:
    """Return the difference of a motion, in px, from those of the neighbours, up to a limit for each."""
    d = later.disparity[y, x]
    total = 0.0
    for n in range(count):
        rate = d * (near[n, 2] - motion[2]) / later.focal
        apart = abs(d * (near[n, 0] - motion[0]) - (x - later.centre_x) * rate)
        apart += abs(d * (near[n, 1] - motion[1]) - (y - later.centre_y) * rate)
        total += min(apart + later.farthest * abs(d * rate), most)
    return total


@_jit
def costs_of(later: Any, q: Any, shift_x: float, shift_y: float, out: Any) -> None:
    """Write the cost of motions, in bits of 48.

    ``q``: Velocity in baselines per frame, shape (3, y, x).
    ``shift_x``, ``shift_y``: Additional flow in columns per frame.
    ``out``: Output, shape (y, x).
    """
    height, width = later.reference.shape
    for y in range(height):
        for x in range(width):
            d = later.disparity[y, x]
            out[y, x] = _cost(later, y, x, q[0, y, x] + shift_x / d, q[1, y, x] + shift_y / d, q[2, y, x])


@_jit
def search(later: Any, q: Any, sweeps: int, changes: int, reach: float, smooth: Any, seed: int) -> None:
    """Improve the motion of every pixel by those of its neighbours, and by random changes of decreasing size.

    ``q``: Velocity in baselines per frame, shape (3, y, x); improved in place.
    ``changes``: Number of random changes in each sweep: of flow, of motion in depth, and of both, in turn.
    ``reach``: Largest change of flow in the first sweep, in columns per frame.
    ``smooth``: Penalty in bits per px of difference from a neighbour; difference in px above which it is constant;
      disparity difference above which a neighbour belongs to another surface.
    """
    height, width = later.reference.shape
    weight, most, same = smooth
    deep = np.isfinite(later.focal)
    costs = np.empty((height, width))
    costs_of(later, q, 0.0, 0.0, costs)
    motion, near = np.empty(3), np.empty((4, 3))
    state = np.uint64(seed * 2 + 88172645463325252)
    for sweep in range(sweeps):
        forth = sweep % 2 == 0
        step = -1 if forth else 1
        for row in range(height):
            y = row if forth else height - 1 - row
            for column in range(width):
                x = column if forth else width - 1 - column
                d = later.disparity[y, x]
                count = _collect_neighbours(later, q, y, x, same, near)
                motion[0], motion[1], motion[2] = q[0, y, x], q[1, y, x], q[2, y, x]
                own = costs[y, x]
                total = own + weight * _unlike(later, y, x, motion, near, count, most)
                for trial in range(2 + changes):
                    n = trial if trial < 2 else 2 + (sweep + x + y + trial) % 3
                    if n == 0 and 0 <= x + step < width:
                        motion[0], motion[1], motion[2] = q[0, y, x + step], q[1, y, x + step], q[2, y, x + step]
                    elif n == 1 and 0 <= y + step < height:
                        motion[0], motion[1], motion[2] = q[0, y + step, x], q[1, y + step, x], q[2, y + step, x]
                    elif n >= 2:
                        motion[0], motion[1], motion[2] = q[0, y, x], q[1, y, x], q[2, y, x]
                        for i in range(3):
                            # xorshift64
                            state ^= state << np.uint64(13)
                            state ^= state >> np.uint64(7)
                            state ^= state << np.uint64(17)
                            chance = float(state >> np.uint64(11)) * 2.0**-52 - 1.0
                            if i < 2 and n != 3:
                                motion[i] += chance * reach / d
                            elif i == 2 and n != 2 and deep:
                                # The flow is unchanged.
                                rate = chance * reach / (d * later.farthest)
                                motion[0] += (x - later.centre_x + d * motion[0]) * rate / d
                                motion[1] += (y - later.centre_y + d * motion[1]) * rate / d
                                motion[2] += rate * later.focal / d
                    else:
                        continue
                    if motion[0] == q[0, y, x] and motion[1] == q[1, y, x] and motion[2] == q[2, y, x]:
                        continue
                    # The difference from the neighbours takes less time than the images, and is often too large.
                    unlike = weight * _unlike(later, y, x, motion, near, count, most)
                    if unlike >= total:
                        continue
                    cost = _cost(later, y, x, motion[0], motion[1], motion[2])
                    tried = cost + unlike
                    if tried < total:
                        total, own = tried, cost
                        q[0, y, x], q[1, y, x], q[2, y, x] = motion[0], motion[1], motion[2]
                costs[y, x] = own
        reach *= 0.5

"""Costs of motions beside plain readings of the images."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.plane_sweep.motion_kernels import HALVES, UNSEEN_BITS, NeighbourFrame, costs_of

Array = NDArray[np.float64]


def plain_cost(later: NeighbourFrame, y: int, x: int, q: Array) -> float:
    d, times = later.disparity[y, x], []
    height, width = later.reference.shape
    for n, t in enumerate(later.t):
        g = 1 / (1 + t * d * q[2] / later.focal)
        sides: dict[int, list[int]] = {-1: [], 0: [], 1: []}
        for v, s in enumerate(later.s):
            column = np.floor(2 * ((x - later.centre_x + d * (t * q[0] - s)) * g + later.centre_x) + 0.5)
            row = np.floor(2 * ((y - later.centre_y + d * t * q[1]) * g + later.centre_y) + 0.5)
            if 0 <= column <= 2 * (width - 1) and 0 <= row <= 2 * (height - 1):
                i, j = int(row), int(column)
                there = later.images[n, v, i % HALVES, j % HALVES, i // HALVES, j // HALVES]
                sides[int(np.sign(s))].append(bin(int(later.reference[y, x] ^ there)).count("1"))
        groups = [sides[0] + sides[side] for side in (1, -1) if sides[0] + sides[side]]
        if groups:
            times.append(min(float(np.mean(group)) for group in groups))
    return 0.75 * min(times) + 0.25 * float(np.mean(times)) if times else UNSEEN_BITS


def test_costs_are_those_of_the_better_time_and_side() -> None:
    generator = np.random.default_rng(0)
    size = (9, 14)
    later = NeighbourFrame(
        generator.integers(0, 2**48, size).astype(np.uint64),
        generator.integers(0, 2**48, (2, 3, HALVES, HALVES, *size)).astype(np.uint64),
        np.array([-1.0, 1.0]),
        np.array([-1.0, 0.0, 1.5]),
        1.5,
        generator.uniform(1, 3, size),
        50.0,
        6.2,
        4.1,
    )
    q = generator.uniform(-2, 2, (3, *size))
    found = np.empty(size)
    costs_of(later, q, 0.3, -0.2, found)
    for y, x in np.ndindex(size):
        shifted = q[:, y, x] + np.array([0.3, -0.2, 0.0]) / later.disparity[y, x]
        assert found[y, x] == pytest.approx(plain_cost(later, y, x, shifted), rel=1e-12)
    assert (found == UNSEEN_BITS).any()
    assert (found != UNSEEN_BITS).any()

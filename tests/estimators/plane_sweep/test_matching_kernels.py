"""Kernels of the plane sweep beside plain readings of what they do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.plane_sweep.matching_kernels import (
    COST_OF_BIT,
    OTHER_SIDE,
    PHASES,
    UNSEEN,
    aggregate,
    agreeing,
    census,
    fill_costs,
    shifted,
    winners,
)

GENERATOR = np.random.default_rng(0)


def plain_census(image: NDArray[np.float32]) -> NDArray[np.uint64]:
    height, width = image.shape
    padded = np.pad(image, 3, mode="edge")
    bits = np.zeros(image.shape, dtype=np.uint64)
    for i in range(7):
        for j in range(7):
            if (i, j) != (3, 3):
                bits = bits << np.uint64(1) | (padded[i : i + height, j : j + width] < image).astype(np.uint64)
    return bits


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (9, 40)])
def test_census_is_which_neighbours_are_darker(size: tuple[int, int]) -> None:
    image = GENERATOR.integers(0, 9, size).astype(np.float32)  # with ties
    found = np.empty(size, dtype=np.uint64)
    census(image, found)
    np.testing.assert_array_equal(found, plain_census(image))


@pytest.mark.parametrize("phase", range(PHASES))
def test_cubic_convolution_is_exact_for_parabolas(phase: int) -> None:
    x = np.arange(12, dtype=np.float32)
    image = np.stack([2 + x, 3 - x + 0.5 * x**2])
    moved = np.empty_like(image)
    shifted(image, phase, moved)
    there = x + phase / PHASES
    expected = np.stack([2 + there, 3 - there + 0.5 * there**2])
    np.testing.assert_allclose(moved[:, 1:-2], expected[:, 1:-2], rtol=1e-6)


@pytest.mark.parametrize("complete", [True, False])
def test_costs_are_mostly_those_of_the_better_side(complete: bool) -> None:
    size, others, left = (3, 23), 3, 2
    reference = GENERATOR.integers(0, 2**48, size).astype(np.uint64)
    views = GENERATOR.integers(0, 2**48, (others, PHASES, *size)).astype(np.uint64)
    whole = np.array([[-1, -2, 3], [-4, -30, 5], [-25, -26, 30]])
    phase = np.array([[0, 3, 1], [1, 0, 0], [0, 1, 2]])
    found = np.empty((*size, 3), dtype=np.uint8)
    known = np.ones((others, 2, *size), dtype=bool) if complete else GENERATOR.random((others, 2, *size)) < 0.7
    covered = np.where(known, np.uint64(2**64 - 1), np.uint64(0))[: 0 if complete else others]
    fill_costs(reference, views, covered, whole, phase, left, found)
    for y, x, k in np.ndindex(found.shape):
        sides: tuple[list[int], list[int]] = ([], [])
        for v in range(others):
            there = x + whole[k, v]
            if 0 <= there < size[1] - (phase[k, v] > 0) and known[v, int(phase[k, v] > 0), y, there]:
                differing = int(reference[y, x] ^ views[v, phase[k, v], y, there])
                sides[v >= left].append(bin(differing).count("1"))
        means = sorted(COST_OF_BIT * np.mean(group) for group in sides if group)
        expected = UNSEEN if not means else (1 - OTHER_SIDE) * means[0] + OTHER_SIDE * means[-1]
        # Cut to whole numbers from single precision.
        assert expected - 1.001 < found[y, x, k] <= expected + 0.001


def plain_aggregate(
    costs: NDArray[np.uint8], edges: NDArray[np.uint8], steps: NDArray[np.uint16], jumps: NDArray[np.uint16]
) -> NDArray[np.int64]:
    height, width, count = costs.shape
    total = np.zeros(costs.shape, dtype=np.int64)
    directions = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    for i, j in directions:
        ways: dict[tuple[int, int], Any] = {}
        rows = range(height) if i >= 0 else range(height)[::-1]
        columns = range(width) if j >= 0 else range(width)[::-1]
        for y in rows:
            for x in columns:
                own = costs[y, x].astype(np.int64)
                before = ways.get((y - i, x - j))
                if before is not None:
                    jump = int(jumps[abs(int(edges[y, x]) - int(edges[y - i, x - j]))])
                    best = before.min()
                    reached = np.minimum(before, best + jump)
                    reached[1:] = np.minimum(reached[1:], before[:-1] + steps[1:count])
                    reached[:-1] = np.minimum(reached[:-1], before[1:] + steps[1:count])
                    own = own + reached - best
                ways[y, x] = own
                total[y, x] += own
    return total


def test_ways_are_those_of_semi_global_matching() -> None:
    size, count = (5, 7), 6
    costs = GENERATOR.integers(0, 193, (*size, count)).astype(np.uint8)
    edges = GENERATOR.integers(0, 256, size).astype(np.uint8)
    steps = np.array([90, 20, 20, 90, 20, 20, 90], dtype=np.uint16)
    jumps = np.maximum(90 / (1 + np.arange(256) / 20), 30).astype(np.uint16)
    found = np.empty(costs.shape, dtype=np.uint16)
    aggregate(costs, edges, steps, jumps, found)
    np.testing.assert_array_equal(found, plain_aggregate(costs, edges, steps, jumps))


def test_the_winner_lies_between_the_vertices_of_a_parabola_and_of_two_lines() -> None:
    k = np.arange(9)
    vertices = np.array([3.2, 4.0, 4.9])
    total = np.rint(1000 + 100 * (k - vertices[:, None]) ** 2).astype(np.uint16)[None]
    total[0, 1, 8] = 1010
    costs = np.arange(27, dtype=np.uint8).reshape(total.shape)
    place, distinct, own = np.empty((3, 1, 3))
    winners(total, costs, 2, place, distinct, own)
    # Lines of equal slopes through the larger neighbour, 144 and 121, and the lowest cost, 4 and 1.
    lines = np.array([3 + 0.5 * (144 - 64) / (144 - 4), 4.0, 5 - 0.5 * (121 - 81) / (121 - 1)])
    np.testing.assert_allclose(place[0], (vertices + lines) / 2, atol=1e-3)
    assert own[0].tolist() == [3, 9 + 4, 18 + 5]
    # Not a neighbour, however good; and ten bits on eight paths.
    assert distinct[0, 1] == (1010 + 320) / (1000 + 320)
    assert distinct[0, 0] == (min(total[0, 0, 0], total[0, 0, 6]) + 320) / (total[0, 0, 3] + 320)


def test_hidden_pixels_are_those_that_another_view_takes_for_others() -> None:
    # At x = 4 and 5 the reference sees a board with disparity 2 in front of one with 0; the other view, which sees it
    # at 2 and 3, cannot see what the reference sees there.
    total = np.full((1, 8, 3), 100, dtype=np.uint16)
    total[0, :, 0], total[0, 4:6, 0], total[0, 4:6, 2] = 10, 100, 5
    place = np.where(np.isin(np.arange(8), (4, 5)), 2.0, 0.0)[None]
    agrees = np.zeros((1, 8), dtype=np.bool_)
    agreeing(total, np.array([0, -1, -2]), place, 0, agrees)
    assert agrees[0].tolist() == [True, True, False, False, True, True, True, True]

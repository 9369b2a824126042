"""Pixels cut along edges, against areas of clipped polygons."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.raycast.edge_cell_kernels import MOST_EDGES, cut_pixels

NODES, WEIGHTS = np.zeros((2, 5, 4))
for order in range(1, 5):
    positions, shares = np.polynomial.legendre.leggauss(order)
    NODES[order, :order], WEIGHTS[order, :order] = positions / 2, shares / 2

Points = NDArray[np.float64]
numbers = some.floats(-1.5, 1.5)
lines = some.tuples(numbers, numbers, numbers, numbers).filter(lambda e: np.hypot(e[0] - e[2], e[1] - e[3]) > 1e-3)


def samples(ends: Points, order: int = 2) -> tuple[Points, Points]:
    """Return the samples of one pixel."""
    return numbered(ends, order)[:2]


def numbered(ends: Points, order: int = 2) -> tuple[Points, Points, NDArray[np.int32]]:
    """Return the samples of one pixel with their cells."""
    firsts, offsets, weights, cells = cut_pixels(
        np.ascontiguousarray(ends), np.array([0, len(ends)]), np.array([order]), NODES, WEIGHTS
    )
    assert firsts.tolist() == [0, len(weights)]
    return offsets, weights, cells


def area_left(one: Points, other: Points) -> float:
    """Return the area of the unit square on one side of a line, by clipping the square (Sutherland and Hodgman)."""
    square = [np.array(corner) for corner in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]

    def side(point: Points) -> float:
        return float((other[0] - one[0]) * (point[1] - one[1]) - (other[1] - one[1]) * (point[0] - one[0]))

    kept = []
    for point, after in zip(square, square[1:] + square[:1], strict=True):
        if side(point) >= 0:
            kept.append(point)
        if side(point) * side(after) < 0:
            share = side(point) / (side(point) - side(after))
            kept.append(point + share * (after - point))
    polygon = np.array(kept).reshape(-1, 2)
    before = np.roll(polygon, 1, axis=0)
    return abs(float(np.sum(before[:, 0] * polygon[:, 1] - before[:, 1] * polygon[:, 0]))) / 2


@given(some.lists(lines, max_size=5))
def test_weights_add_up_to_the_pixel_and_samples_are_inside(edges: list[tuple[float, ...]]) -> None:
    offsets, weights = samples(np.array(edges).reshape(-1, 4))
    assert weights.sum() == pytest.approx(1, abs=1e-7)
    assert (weights > 0).all()
    assert (np.abs(offsets) < 0.5).all()
    # A plane is averaged exactly, whatever the cells are.
    assert weights @ (2 + 3 * offsets[:, 0] - offsets[:, 1]) == pytest.approx(2, abs=1e-6)


@given(lines, some.lists(lines, max_size=3))
def test_the_area_on_each_side_of_an_edge_is_exact(edge: tuple[float, ...], others: list[tuple[float, ...]]) -> None:
    one, other = np.array(edge[:2]), np.array(edge[2:])
    step = (other - one) / np.linalg.norm(other - one)
    # The edge goes on beyond the pixel, as a silhouette does.
    ends = np.array([[*(one - 4 * step), *(other + 4 * step)], *others])
    offsets, weights = samples(ends)
    side = step[0] * (offsets[:, 1] - one[1]) - step[1] * (offsets[:, 0] - one[0])
    assert weights[side > 0].sum() == pytest.approx(area_left(one, other), abs=1e-6)


def segments_cross(one: Points, other: Points) -> bool:
    """Return whether two segments x0, y0, x1, y1 cross."""

    def sides(line: Points, points: Points) -> Points:
        step, ends = line[2:] - line[:2], points.reshape(2, 2) - line[:2]
        return np.asarray(step[0] * ends[:, 1] - step[1] * ends[:, 0])

    return bool(np.prod(sides(one, other)) < 0 and np.prod(sides(other, one)) < 0)


@given(some.lists(lines, min_size=1, max_size=4), some.integers(1, 4))
def test_no_edge_passes_between_samples_of_a_cell(edges: list[tuple[float, ...]], order: int) -> None:
    ends = np.array(edges)
    offsets, _, cells = numbered(ends, order)
    for cell in np.unique(cells):
        inside = offsets[cells == cell]
        for place in inside[1:]:
            way = np.concatenate([inside[0], place])
            assert not any(segments_cross(way, edge) for edge in ends)


def test_cells_are_numbered_in_each_pixel() -> None:
    # A corner: above it one cell, beside and below it two.
    _, _, cells = numbered(np.array([[0.1, 0.2, 0.1, 3.0], [0.1, 0.2, 3.0, 0.2]]), order=4)
    assert np.unique(cells).tolist() == [0, 1, 2]
    assert np.bincount(cells).tolist() == [3 * 4, 2 * 3, 2 * 2]
    ends = np.tile([-1.0, 0.25, 1.0, 0.25], (2, 1))
    *_, cells = cut_pixels(ends, np.array([0, 1, 2]), np.array([1, 1]), NODES, WEIGHTS)
    assert cells.tolist() == [0, 1, 0, 1]


def test_a_corner_and_an_edge_along_the_grid_are_exact() -> None:
    offsets, weights = samples(np.array([[0.1, 0.2, 0.1, 3.0], [0.1, 0.2, 3.0, 0.2]]))
    corner = (offsets[:, 0] > 0.1) & (offsets[:, 1] > 0.2)
    assert weights[corner].sum() == pytest.approx(0.4 * 0.3, abs=1e-12)


def test_pixels_have_their_own_edges_and_orders() -> None:
    ends = np.tile([-1.0, 0.25, 1.0, 0.25], (MOST_EDGES, 1))
    starts = np.array([0, 0, 1, MOST_EDGES])
    firsts, offsets, weights, _ = cut_pixels(ends, starts, np.array([1, 2, 4]), NODES, WEIGHTS)
    assert np.diff(firsts).tolist() == [1, 2 * 2 + 2 * 1, 4 * 3 + 4 * 1]
    np.testing.assert_allclose(np.add.reduceat(weights, firsts[:-1]), 1)
    assert (offsets[: firsts[1]] == 0).all()

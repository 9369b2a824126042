"""Areas on both sides of borders, from the states of single points, against exact areas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.render.border_areas import grid_offsets, measure_areas
from tests.helpers.pixel_areas import area_beyond

Side = Callable[[NDArray[np.float64]], NDArray[np.bool_]]


def area_of(side: Side, cells: int, rounds: int) -> float:
    """Return the area of one side in a pixel."""
    states = side(grid_offsets(cells)).astype(np.uint64).reshape(1, cells + 1, cells + 1)
    areas = measure_areas(states, lambda _, places: side(places).astype(np.uint64), rounds)
    assert areas.min() >= -1e-12
    assert areas.sum() == pytest.approx(1.0, abs=1e-12)
    return float((areas * states).sum())


@given(
    angle=some.one_of(some.floats(0, 6.3), some.sampled_from([0, np.pi / 4, np.pi / 2])),
    distance=some.floats(-0.6, 0.6),
    cells=some.integers(2, 6),
)
def test_straight_borders_are_exact_but_for_the_bisection(angle: float, distance: float, cells: int) -> None:
    normal, rounds = np.array([np.cos(angle), np.sin(angle)]), 12
    found = area_of(lambda places: places @ normal > distance, cells, rounds)
    # Up to 1.5 cells + 2 places on lines and 3 on chords are wrong by up to 2^-13 cells each, along a border of a cell.
    assert found == pytest.approx(area_beyond(normal, distance), abs=(3 * cells + 2) * 2**-13 * 1.5 / cells**2 + 1e-12)


@given(angle=some.floats(0, 6.3), radius=some.floats(2.0, 20.0))
@settings(max_examples=20, deadline=None)
def test_curved_borders_converge(angle: float, radius: float) -> None:
    centre = (radius - 0.1) * np.array([np.cos(angle), np.sin(angle)])

    def inside(places: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(np.hypot(*(places - centre).T) < radius)

    # By integration of chords at 20,000 heights.
    y = (np.arange(20000) + 0.5) / 20000 - 0.5
    half = np.sqrt(np.maximum(radius**2 - (y - centre[1]) ** 2, 0.0))
    low, high = np.clip([centre[0] - half, centre[0] + half], -0.5, 0.5)
    exact = float(np.mean(high - low))
    for cells in (2, 8):
        # Between places on the border, half a cell apart, the segment of a circle has the area h³ / (12 R).
        assert area_of(inside, cells, 14) == pytest.approx(exact, abs=2 / (12 * radius * cells**2) + 1e-4)


def test_three_states_share_a_pixel() -> None:
    def state_at(_: NDArray[np.int64], places: NDArray[np.float64]) -> NDArray[np.uint64]:
        x, y = places.T
        return np.where(x < 0.07, 1, np.where(y < -0.11, 2, 3)).astype(np.uint64)

    nodes = grid_offsets(4)
    states = state_at(np.zeros(25, dtype=np.int64), nodes).reshape(1, 5, 5)
    areas = measure_areas(states, state_at, 14)
    expected = [0.57, 0.43 * 0.39, 0.43 * 0.61]
    # Where the three meet, the cell of 1/16 is divided by lines from the mean of its crossings.
    for state, area in enumerate(expected, start=1):
        assert (areas * (states == state)).sum() == pytest.approx(area, abs=1 / 64)


def test_without_a_border_nodes_have_the_weights_of_trapezoids() -> None:
    areas = measure_areas(np.zeros((2, 3, 3), dtype=np.uint64), lambda *_: np.empty(0, dtype=np.uint64), 4)
    weights = np.array([0.25, 0.5, 0.25])
    np.testing.assert_allclose(areas, np.tile(np.outer(weights, weights), (2, 1, 1)), atol=1e-15)

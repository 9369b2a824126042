"""Regions against distances found by trying every pair of pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenetruth.errors import ScoreError
from scenetruth.score.regions import REGIONS, edge_distance, region_masks

shapes = some.tuples(some.integers(1, 2), some.integers(1, 9), some.integers(1, 9))


def brute_force_distance(mixed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Measure from every pixel to every mixed pixel of its frame."""
    distance = np.full(mixed.shape, math.inf)
    for t, y, x in np.ndindex(mixed.shape):
        for there_y, there_x in np.argwhere(mixed[t]):
            distance[t, y, x] = min(distance[t, y, x], math.hypot(y - there_y, x - there_x))
    return distance


@given(arrays.arrays(bool, shapes))
def test_distance_is_that_to_the_nearest_mixed_pixel(mixed: NDArray[np.bool_]) -> None:
    np.testing.assert_allclose(edge_distance(mixed), brute_force_distance(mixed), rtol=1e-12)


@given(arrays.arrays(bool, (1, 7, 8)), arrays.arrays(bool, (1, 7, 8)), some.integers(0, 5))
def test_interior_is_what_is_far_enough_and_seen(
    mixed: NDArray[np.bool_], seen: NDArray[np.bool_], margin: int
) -> None:
    depth = np.where(seen, 660.0, np.nan)
    masks = region_masks(depth, mixed, float(margin))
    assert tuple(masks) == REGIONS
    np.testing.assert_array_equal(masks["all"], seen)
    np.testing.assert_array_equal(masks["interior"], seen & (brute_force_distance(mixed) >= margin))


def test_distance_of_exactly_the_margin_is_interior() -> None:
    mixed = np.zeros((1, 1, 30), dtype=bool)
    mixed[0, 0, 2] = True
    interior = region_masks(np.ones(mixed.shape), mixed)["interior"][0, 0]
    assert np.flatnonzero(interior).tolist() == list(range(22, 30))


def test_image_border_is_no_silhouette() -> None:
    assert region_masks(np.ones((2, 5, 5)), np.zeros((2, 5, 5), dtype=bool))["interior"].all()


def test_frames_do_not_touch_each_other() -> None:
    mixed = np.zeros((2, 3, 3), dtype=bool)
    mixed[0] = True
    interior = region_masks(np.ones((2, 3, 3)), mixed)["interior"]
    assert not interior[0].any()
    assert interior[1].all()


@pytest.mark.parametrize("margin", [-1.0, math.nan, math.inf])
def test_impossible_margin_is_refused(margin: float) -> None:
    with pytest.raises(ScoreError, match="margin_px: must be a finite number, not negative"):
        region_masks(np.ones((1, 1)), np.zeros((1, 1), dtype=bool), margin)

"""Percentiles of values that come in parts are NumPy's of all together, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.estimators.opencv_common import outer_percentiles

numbers = some.floats(-1e6, 1e6, width=32) | some.just(float("nan")) | some.integers(0, 3).map(float)
parts = some.lists(some.lists(numbers, max_size=12), min_size=1, max_size=12)


@given(parts.filter(lambda some: any(value == value for part in some for value in part)), some.floats(0, 50))
def test_parts_give_what_the_whole_gives(parts: list[list[float]], percent: float) -> None:
    together = np.concatenate([np.array(part, dtype=np.float64) for part in parts])
    found = outer_percentiles((np.array(part, dtype=np.float64) for part in parts), percent, together.size)
    assert found == tuple(np.nanpercentile(together, (percent, 100 - percent)))


@pytest.mark.parametrize("order", ["random", "rising", "falling"])
def test_many_values_are_left_out_and_never_missed(order: str) -> None:
    """Of 300,000 values 300 are beyond either percentile: what is kept is cut down again and again."""
    values = np.random.default_rng(5).normal(size=300_000)
    if order != "random":
        values = np.sort(values)[:: 1 if order == "rising" else -1]
    found = outer_percentiles(np.array_split(values, 150), 0.1, values.size)
    assert found == tuple(np.nanpercentile(values, (0.1, 99.9)))


def test_nothing_known_has_no_percentile() -> None:
    with pytest.warns(RuntimeWarning, match="NaN"):
        assert np.isnan(outer_percentiles([np.full(3, np.nan)], 0.1, 3)).all()

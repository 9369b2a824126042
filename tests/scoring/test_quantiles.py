"""Quantiles of values that come in parts, against sorting them all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenetruth.scoring.statistics import StreamingQuantiles

PERCENT = (0, 1, 5, 50, 95, 99, 100)
# Outside of 2^-48 to 2^48 there are no bins.
values = some.one_of(
    some.floats(-1e9, 1e9).filter(lambda value: value == 0 or abs(value) > 1e-12), some.just(0.0), some.just(3.0)
)


@given(arrays.arrays(np.float64, some.integers(1, 60), elements=values), some.integers(1, 5))
@example(np.array([-1.0, -1.0, 2.0]), 2)
@example(np.array([0.0, 0.0]), 1)
def test_parts_are_right_to_a_bin(whole: NDArray[np.float64], count: int) -> None:
    found = StreamingQuantiles(single=False)
    for part in np.array_split(whole, count):
        found.add(part)
    # Between two values, a histogram knows nothing: the quantile lies between the neighbouring ones, or in their bins.
    low, high = (np.percentile(whole, PERCENT, method=method) for method in ("lower", "higher"))
    widest = np.maximum(np.abs(low), np.abs(high)) * 2.0**-9 + 2.0**-48
    at = np.array(found.at(PERCENT))
    assert (at >= low - widest).all()
    assert (at <= high + widest).all()


def test_many_values_are_right_to_the_stated_bound() -> None:
    rng = np.random.default_rng(3)
    whole = rng.normal(0.2, 1.0, 200_000)
    found = StreamingQuantiles(single=False)
    for part in np.array_split(whole, 7):
        found.add(part)
    np.testing.assert_allclose(found.at(PERCENT), np.percentile(whole, PERCENT), rtol=2e-3)


def test_one_part_is_exact() -> None:
    whole = np.random.default_rng(4).normal(size=1001)
    found = StreamingQuantiles(single=True)
    found.add(whole)
    assert found.at(PERCENT) == np.percentile(whole, PERCENT).tolist()


@pytest.mark.parametrize("single", [True, False])
def test_of_nothing_there_are_none(single: bool) -> None:
    found = StreamingQuantiles(single=single)
    found.add(np.empty(0))
    assert np.isnan(found.at([50])).all()


def test_what_has_no_end_is_told_so() -> None:
    found = StreamingQuantiles(single=False)
    found.add(np.array([1.0, np.inf, np.inf]))
    low, middle, high = found.at([0, 50, 100])
    assert low == pytest.approx(1.0, rel=2e-3)
    assert (middle, high) == (np.inf, np.inf)

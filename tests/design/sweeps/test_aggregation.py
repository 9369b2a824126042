"""Intervals over seeds, against what is known of normal numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.design.sweeps import (
    Interval,
    compute_mean,
    compute_normal_statistics,
    compute_positive_mean,
    compute_root_mean_square,
    compute_scatter,
)

TRIALS = 600
# Of 600 intervals that hold in 95 of 100 cases, 91.5 to 98 hold with four standard deviations.
LEAST_HELD = 0.915


def held(interval: Interval | None, true: float) -> bool:
    assert interval is not None
    return interval[1] <= true <= interval[2]


def test_intervals_of_normal_errors_hold() -> None:
    generator = np.random.default_rng(1)
    shares = np.zeros(3)
    for _ in range(TRIALS):
        errors = generator.normal(0.3, 2.0, (5, 40))
        shares += [
            held(compute_mean(errors.mean(axis=1).tolist()), 0.3),
            held(compute_root_mean_square(np.sqrt(np.square(errors).mean(axis=1)).tolist()), math.hypot(0.3, 2.0)),
            held(compute_scatter(errors), 2.0),
        ]
    assert (shares / TRIALS > LEAST_HELD).all(), shares / TRIALS


@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=8), st.floats(1e-3, 1e3))
def test_intervals_scale_with_their_numbers(values: list[float], factor: float) -> None:
    for each in (compute_mean, compute_positive_mean, compute_root_mean_square):
        one, other = each(values), each([factor * value for value in values])
        # Up to rounding, and half widths of nearly equal numbers are all rounding.
        assert other == pytest.approx(
            [factor * end for end in one], rel=1e-6, abs=1e-9 * factor * max(values), nan_ok=True
        )
        assert one[1] <= one[0] <= one[2] or math.isnan(one[1])


def test_scatter_is_that_of_pixels_told_with_every_seed() -> None:
    errors = np.array([[1.0, 5.0, np.nan], [3.0, 5.0, 2.0], [2.0, 5.0, 2.0]])
    found = compute_scatter(errors)
    assert found is not None
    # Variances 1 and 0 of the first two pixels.
    assert found[0] == pytest.approx(math.sqrt(0.5))
    assert compute_scatter(errors[:1]) is None
    assert compute_scatter(errors[:, 2:]) is None
    assert np.isnan(compute_scatter(errors[:2])[1:]).all()  # type: ignore[index]
    assert np.isnan(compute_mean([1.0])[1:]).all()
    # What is zero has no logarithm.
    assert compute_positive_mean([0.0, 0.0])[0] == 0


def test_sizes_of_normal_errors_are_those_of_drawn_ones() -> None:
    std = np.array([0.5, 1.0, 4.0])
    drawn = np.random.default_rng(2).normal(0.0, std, (200_000, 3))
    found = compute_normal_statistics(np.array([0.5, 1.0, 4.0, np.nan]))
    # 600 000 numbers tell both to some 0.2 %.
    assert found["rmse"] == pytest.approx(float(np.sqrt(np.square(drawn).mean())), rel=0.01)
    assert found["median_abs_error"] == pytest.approx(float(np.median(np.abs(drawn))), rel=0.01)
    assert compute_normal_statistics(np.array([np.nan])) == {}

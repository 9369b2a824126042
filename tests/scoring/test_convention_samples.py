"""Weighted medians, and factors fitted by them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra.numpy import arrays

from scenetruth.scoring.convention_samples import fit_factor, lengths, weighted_median


@given(some.lists(some.tuples(some.floats(-1e3, 1e3), some.integers(0, 5)), min_size=1))
def test_whole_weights_repeat_values(items: list[tuple[float, int]]) -> None:
    values, weights = np.array(items, dtype=np.float64).T
    repeated = np.sort(np.repeat(values, weights.astype(int)))
    found = weighted_median(values, weights)
    if repeated.size:
        # Of an even number the lower one of the two in the middle.
        assert found == repeated[(len(repeated) - 1) // 2]
    else:
        assert np.isnan(found)


@given(arrays(np.float64, (2, 30), elements=some.integers(-10, 10)), some.floats(-5, 5))
def test_no_factor_leaves_less_than_the_fitted_one(expected: np.ndarray, other: float) -> None:
    found = 3 * expected + np.sin(np.arange(60.0)).reshape(2, 30)
    factor = fit_factor(found, expected)
    if not expected.any():
        assert np.isnan(factor)
        return

    def left(a: float) -> float:
        return float(np.abs(found - a * expected)[expected != 0].sum())

    # Rounding in sums of 60 terms up to 60.
    assert left(factor) <= left(other) + 1e-9


def test_outliers_do_not_move_the_factor() -> None:
    expected = np.linspace(1, 2, 101)[None]
    found = 4 * expected
    found[0, ::4] = 1e6
    assert fit_factor(found, expected) == 4


@given(arrays(np.float64, (3, 4), elements=some.floats(-1e3, 1e3)))
def test_lengths_are_euclidean(vectors: np.ndarray) -> None:
    np.testing.assert_allclose(lengths(vectors), np.linalg.norm(vectors, axis=0), rtol=1e-12)
    np.testing.assert_array_equal(lengths(vectors[:1]), np.abs(vectors[0]))

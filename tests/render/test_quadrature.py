"""Rules that average a pixel: their moments, and how they treat waves."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.render.raycast_backend import even_rule, gauss_rule


def exact_moment(degree: int) -> float:
    """Return the mean of x ** degree over [-1/2, 1/2]."""
    return 0.0 if degree % 2 else 0.5**degree / (degree + 1)


@pytest.mark.parametrize("n", range(1, 17))
def test_gauss_rule_is_exact_up_to_degree_2n_less_1(n: int) -> None:
    positions, weights = gauss_rule(n)
    for degree in range(2 * n):
        assert np.sum(weights * positions**degree) == pytest.approx(exact_moment(degree), abs=1e-15)


@pytest.mark.parametrize("n", range(1, 17))
def test_even_rule_is_even_and_exact_for_cubics_from_three_samples_on(n: int) -> None:
    positions, weights = even_rule(n)
    np.testing.assert_allclose(positions, (np.arange(n) + 0.5) / n - 0.5, atol=1e-15)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-15)
    assert (weights > 0).all()
    for degree in (0, 1, 2, 3) if n > 2 else (0, 1):
        assert np.sum(weights * positions**degree) == pytest.approx(exact_moment(degree), abs=1e-15)


@pytest.mark.parametrize("n", [3, 4, 8])
def test_even_rule_is_the_nearest_to_equal_weights(n: int) -> None:
    # The smallest change that mends the moments, from the pseudo-inverse instead of the formula.
    positions, weights = even_rule(n)
    moments = np.stack([positions**degree for degree in range(4)])
    missing = [exact_moment(degree) for degree in range(4)] - moments @ np.full(n, 1 / n)
    np.testing.assert_allclose(weights, 1 / n + np.linalg.pinv(moments) @ missing, atol=1e-13)


def test_a_wave_of_six_pixels_loses_the_error_of_equal_weights() -> None:
    frequency, n = 1 / 6, 4
    positions, weights = even_rule(n)
    exact = np.sinc(frequency)
    equal = np.mean(np.cos(2 * np.pi * frequency * positions))
    assert equal / exact - 1 == pytest.approx((np.pi * frequency / n) ** 2 / 6, rel=0.01)
    assert abs(np.sum(weights * np.cos(2 * np.pi * frequency * positions)) / exact - 1) < 1e-4

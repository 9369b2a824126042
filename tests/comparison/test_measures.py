"""Figures of errors: known errors give them back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as strategies
from scipy import ndimage, special

from scenetruth.benchmark.error_statistics import (
    COVERAGE_FACTORS,
    compute_coverage,
    compute_interval_statistics,
    compute_rms_z,
    compute_sparsification,
)
from scenetruth.benchmark.spatial_resolution import compute_amplitude_ratio, compute_cutoff_periods

GENERATOR = np.random.default_rng(3)


def test_noise_and_bias_come_back() -> None:
    errors = GENERATOR.normal(0.03, 0.2, (4, 90, 110))
    kept = GENERATOR.random(errors.shape) < 0.7
    found = compute_interval_statistics(errors, kept)
    # 27,720 values: their standard deviation is known to 0.4 %.
    assert found["precision_std"].value == pytest.approx(0.2, rel=0.02)
    assert found["bias"].value == pytest.approx(errors[kept].mean())
    assert found["rmse"].value == pytest.approx(np.hypot(0.03, 0.2), rel=0.02)
    # The median of |N(0, 1)| is 0.6745; the bias changes it by a hundredth.
    assert found["median_abs_error"].value == pytest.approx(0.6745 * 0.2, rel=0.03)
    for name in ("rmse", "precision_std", "bias"):
        assert found[name].ci_low < found[name].value < found[name].ci_high


def test_intervals_hold_the_truth_though_neighbours_err_alike() -> None:
    # Errors that are the same over some 5 px; single pixels drawn again would give intervals five times too small.
    held = 0
    for seed in range(60):
        white = np.random.default_rng(seed).normal(size=(1, 110, 146))
        smooth = ndimage.gaussian_filter(white, (0, 3, 3), mode="wrap")
        smooth *= 2 * 3 * np.sqrt(np.pi)
        found = compute_interval_statistics(smooth, np.ones(smooth.shape, dtype=bool))["rmse"]
        held += found.ci_low <= 1.0 <= found.ci_high
    # 95 % of 60 are 57; fewer than 50 would happen once in a thousand tries.
    assert held >= 50


def test_nothing_is_told_of_nothing() -> None:
    assert compute_interval_statistics(np.zeros((1, 4, 4)), np.zeros((1, 4, 4), dtype=bool)) == {}
    few = np.zeros((1, 40, 40), dtype=bool)
    few[0, 3, 3:9] = True
    assert np.isnan(compute_interval_statistics(np.ones(few.shape), few)["rmse"].ci_low)


@given(strategies.floats(0.2, 5.0))
def test_error_bars_scaled_give_the_inverse(factor: float) -> None:
    errors = np.random.default_rng(1).normal(0, 0.1, 40_000)
    std = np.full(errors.shape, 0.1 * factor)
    # 40,000 values: to 0.4 %.
    assert compute_rms_z(errors, std) == pytest.approx(1 / factor, rel=0.02)
    expected = [special.erf(number * factor / np.sqrt(2)) for number in COVERAGE_FACTORS]
    np.testing.assert_allclose(compute_coverage(errors, std), expected, atol=0.01)


def test_confidence_that_knows_sorts_errors() -> None:
    std = GENERATOR.uniform(0.1, 1.0, 50_000)
    errors = GENERATOR.normal(0, std)
    curve = compute_sparsification(errors, std)
    assert np.all(np.diff(curve) > 0)
    # The surest tenth have standard deviations from 0.1 to 0.19.
    assert curve[0] == pytest.approx(np.sqrt(np.mean(np.linspace(0.1, 0.19, 100) ** 2)), rel=0.03)
    assert curve[-1] == pytest.approx(np.sqrt(np.mean(errors**2)))
    # Confidence that knows nothing leaves the same everywhere.
    np.testing.assert_allclose(compute_sparsification(errors, GENERATOR.random(errors.shape)), curve[-1], rtol=0.05)


@pytest.mark.parametrize("sigma_px", [3.0, 5.0, 8.0])
def test_the_cut_off_of_a_known_window_comes_back(sigma_px: float) -> None:
    # A Gaussian window leaves exp(-(2 pi sigma / p)^2 / 2) of a wave of period p.
    expected = 2 * np.pi * sigma_px / np.sqrt(-2 * np.log(0.9))
    periods = expected * np.array([2.5, 1.6, 1.2, 0.9, 0.6])
    left = []
    for period in periods:
        wave = np.cos(2 * np.pi * np.arange(4000) / period)
        blurred = ndimage.gaussian_filter1d(wave, sigma_px, mode="reflect", truncate=6)
        left.append(compute_amplitude_ratio(blurred[400:-400], wave[400:-400]))
    first, last = compute_cutoff_periods(list(periods), left)
    assert first == last
    # What is interpolated is of this form; the kernel is cut off and sampled.
    assert first == pytest.approx(expected, rel=0.01)


def test_crossings_that_are_not_there() -> None:
    assert compute_cutoff_periods([80, 40], [1.0, 0.99]) == (0.0, 0.0)
    assert compute_cutoff_periods([80, 40], [0.5, 0.4]) == (np.inf, np.inf)
    # Found again below: what looks resolved at 20 px is not to be trusted at 40 px.
    first, last = compute_cutoff_periods([80, 40, 20, 10], [1.0, 0.8, 0.95, 0.5])
    assert 40 < first < 80
    assert 10 < last < 20
    assert compute_cutoff_periods([80, 40, 20], [1.0, np.nan, np.nan])[0] > 40

"""Linear changes over a surface are separated from the noise of windows, which is correlated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.estimators.refined import fit_linear_changes

Array = NDArray[np.float64]

SHAPE = (60, 80)
EVERYWHERE = np.ones(SHAPE, dtype=np.bool_)


def window_noise(seed: int) -> Array:
    """Unit noise of windows of 1 node: white noise in Gaussian windows of σ has a correlation of exp(-r² / 4σ²)."""
    drawn = ndimage.gaussian_filter(np.random.default_rng(seed).normal(0.0, 1.0, (120, 120)), 1.0)
    return np.asarray((drawn / drawn.std())[30:90, 20:100])


def test_a_turn_is_seen_at_its_axis_and_noise_is_not() -> None:
    """A change of 0.3 standard deviations at 40 nodes from an axis, of which each window alone shows nothing."""
    at = np.indices(SHAPE)[1] - 39.5
    alone = [fit_linear_changes(window_noise(seed)[None], np.ones((1, *SHAPE)), EVERYWHERE, 1.0) for seed in range(12)]
    assert np.mean([each.significant.any() for each in alone]) < 0.1
    turned = 0.6 / 40 * at
    found = fit_linear_changes((window_noise(1) + turned)[None], np.ones((1, *SHAPE)), EVERYWHERE, 1.0)
    assert found.significant.all()
    # The variance of the mean over n nodes is 4 π / n of that of one.
    expected = np.sqrt(4 * np.pi / at.size)
    assert np.sqrt(found.square[0, :, 39:41].min()) == pytest.approx(expected, rel=0.5)
    assert np.abs(np.sqrt(found.square[0]) - np.abs(turned)).max() < 5 * expected


def test_the_square_contains_the_variance_of_the_estimate() -> None:
    """Without any change, the mean over draws is that of the estimate and its variance: twice the variance.

    It is 4 π / n at the centre, and 1 + 12 (u² + v²) times this at relative distances u and v from it. Of 20 draws of
    three parameters, the mean has a standard deviation of √(2 / 20) / 2 = 16 %.
    """
    ones = np.ones((1, *SHAPE))
    draws = [fit_linear_changes(window_noise(seed)[None], ones, EVERYWHERE, 1.0).square[0] for seed in range(20)]
    v, u = (np.indices(SHAPE) - np.array([29.5, 39.5])[:, None, None]) / np.array(SHAPE)[:, None, None]
    expected = 2 * 4 * np.pi / u.size * (1 + 12 * (u**2 + v**2))
    assert np.mean(np.mean(draws, axis=0) / expected) == pytest.approx(1.0, abs=0.5)


def test_surfaces_are_separate_and_outliers_do_not_count() -> None:
    among = EVERYWHERE.copy()
    among[:, 38:42] = False
    change = window_noise(3)
    change[:, 42:] += 3.0
    change[10:14, 50:54] += 300.0
    change[50, 5] = np.nan
    found = fit_linear_changes(change[None], np.ones((1, *SHAPE)), among, 1.0)
    assert not found.significant[0, :, :38].any()
    assert found.significant[0, :, 42:].all()
    assert np.sqrt(np.median(found.square[0, :, 42:])) == pytest.approx(3.0, abs=0.5)
    assert not found.square[0, :, 38:42].any()


def test_a_small_surface_has_no_linear_change() -> None:
    among = np.zeros(SHAPE, dtype=np.bool_)
    among[20:26, 20:26] = True
    assert not fit_linear_changes(np.full((1, *SHAPE), 9.0), np.ones((1, *SHAPE)), among, 1.0).significant.any()

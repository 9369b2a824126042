"""How the noise's variance depends on the grey value, and what it brings to know it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st_
from numpy.typing import NDArray

from scenetruth.estimators.refined import EVEN, GreyVariance, estimate_variance, photon_transfer_variance
from tests.helpers.estimated_plane import INSIDE, errors, estimated
from tests.helpers.wavy_plane import MovingPlane

DARK, GAIN = 0.004, 0.002


@given(st_.floats(0.1, 100.0), st_.floats(0.0, 10.0), st_.integers(0, 99))
def test_a_photon_transfer_is_found(gain: float, dark: float, seed: int) -> None:
    """Squares of 45 images scatter by a fifth; of 40,000 pixels, each quartile by 1 %; the line's ends by some more."""
    generator = np.random.default_rng(seed)
    grey = generator.uniform(10.0, 200.0, 40_000)
    true = dark**2 + gain * grey
    square = true * generator.chisquare(44, grey.shape) / 44
    # One of ten pixels is not fitted.
    square[::10] *= 9.0
    found, expected = estimate_variance(grey, square), photon_transfer_variance(dark, gain, 0.0, float(grey.mean()))
    at = np.array([10.0, 105.0, 200.0])
    np.testing.assert_allclose(found.at(at), expected.at(at), rtol=0.1, atol=0.02)
    np.testing.assert_allclose(expected.at(at), (dark**2 + gain * at) / (dark**2 + gain * grey.mean()), rtol=1e-9)


def test_equal_noise_stays_equal() -> None:
    generator = np.random.default_rng(0)
    grey = generator.uniform(10.0, 200.0, 40_000)
    found = estimate_variance(grey, generator.chisquare(44, grey.shape) / 44)
    np.testing.assert_allclose(found.at(np.array([10.0, 200.0])), 1.0, atol=0.05)
    # Less noise where it is brighter is no photon transfer; and nothing tells where all is alike, or nothing known.
    assert estimate_variance(grey, 1.0 / grey) == EVEN
    assert estimate_variance(np.full(1000, 7.0), np.ones(1000)) == EVEN
    assert estimate_variance(grey, np.full(grey.shape, np.inf)) == EVEN


def test_where_all_is_dark_noise_does_not_vanish() -> None:
    assert GreyVariance(-0.5, 1.0).at(np.array([0.0, 1.0])).tolist() == [0.01, 0.5]


def scaled(found: xr.Dataset, plane: MovingPlane) -> NDArray[Any]:
    parts = [errors(found, plane, name) / found[f"{name}_std"].isel(INSIDE).values for name in ("depth", "velocity")]
    return np.concatenate([part.reshape(-1, *part.shape[-2:]) for part in parts])


def test_weights_by_noise_bring_smaller_errors_that_are_stated() -> None:
    """Grey values from 0.01 to 1 with shot noise: bright pixels have a hundred times the variance of dark ones."""
    plane = MovingPlane(size=(96, 128))
    recording = plane.recording()
    image = recording["image"]
    bright = 0.1 * np.exp(8.0 * (image.values - 0.5))
    noise = np.random.default_rng(1).normal(0.0, 1.0, image.shape) * np.sqrt(DARK**2 + GAIN * bright)
    recording = recording.assign(image=(image.dims, bright + noise, image.attrs))
    known: Any = {"dark_noise_dn": DARK, "gain_dn_per_e": GAIN}
    even, *weighted = (estimated(plane, recording, surface="plane", noise=n) for n in ("uniform", "estimated", known))
    for found in weighted:
        assert (found["depth_std"] / even["depth_std"]).median() < 0.97
        assert np.std(errors(found, plane, "depth")) < 0.95 * np.std(errors(even, plane, "depth"))
        # 20 windows that share no noise, four quantities: the root of 80 mean squares scatters by 8 %.
        assert np.sqrt(np.mean(scaled(found, plane) ** 2)) == pytest.approx(1.0, abs=0.2)
        # In grey values, of the mean one.
        expected = np.sqrt(DARK**2 + GAIN * bright[2, 4].mean())
        assert found["residual"].median() == pytest.approx(expected, rel=0.05)

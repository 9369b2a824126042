"""Gains are stated where the noise depends on the light, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.capture.image_reading import FrameMoments, frame_moments
from scenetruth.capture.measured_noise import without_undetermined_gain
from scenetruth.capture.radiometry import SensorNoise, measure_noise

FULL = 4095
SHAPE = (80, 100)


def scene() -> NDArray[np.float64]:
    return np.broadcast_to(np.linspace(200.0, 3600.0, SHAPE[1]), SHAPE)


def added(light: NDArray[np.float64] | float, count: int, black: float, seed: int) -> FrameMoments:
    """Return frames whose noise of 8 DN does not depend on the light, cut off at 0."""
    draw = np.random.default_rng(seed)
    return frame_moments(np.clip(np.rint(black + light + draw.normal(0, 8, (count, *SHAPE))), 0, FULL))


def of_photons(light: NDArray[np.float64] | float, count: int, seed: int, gain: float = 0.4) -> FrameMoments:
    draw = np.random.default_rng(seed)
    electrons = draw.poisson(np.broadcast_to(np.asarray(light) / gain, (count, *SHAPE)))
    return frame_moments(np.clip(np.rint(30 + gain * electrons + draw.normal(0, 2, electrons.shape)), 0, FULL))


@pytest.mark.parametrize("black", [0.0, 100.0], ids=["cut off", "whole"])
def test_added_noise_has_no_gain(black: float) -> None:
    dark, flat, static = added(0, 16, black, 1), added(2500, 16, black, 2), added(scene(), 16, black, 3)
    before = measure_noise(dark, flat, static=static, full_scale=FULL)
    if black == 0:
        # Dark frames that are cut off have less noise; the difference looks like that of light: (1/2 - 1/2π) 64 DN².
        assert before.gain_dn_per_e == pytest.approx((0.5 + 0.5 / np.pi) * 64 / 2500, rel=0.1)
    found = without_undetermined_gain(before, [static], FULL)
    assert np.isnan([found.gain_dn_per_e, found.gain_std, found.dsnu_e, found.temporal_dark_noise_e]).all()
    assert found.dark_noise_dn == before.dark_noise_dn
    assert "not determinable: the noise does not depend on the light" in found.notes[-1]
    assert not any(line.startswith("gain K:") for line in found.describe())


def test_noise_of_photons_keeps_its_gain() -> None:
    dark, flat, static = of_photons(0, 16, 4), of_photons(2500, 16, 5), of_photons(scene(), 16, 6)
    before = measure_noise(dark, flat, static=static, full_scale=FULL)
    assert before.gain_dn_per_e == pytest.approx(0.4, rel=0.03)
    assert without_undetermined_gain(before, [static], FULL) is before
    # Frames of one brightness decide nothing.
    assert without_undetermined_gain(before, [flat], FULL) is before
    assert without_undetermined_gain(before, [], FULL) is before
    without = SensorNoise(*(np.nan,) * 12)
    assert without_undetermined_gain(without, [static], FULL) is without

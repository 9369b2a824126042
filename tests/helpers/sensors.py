"""What tests of sensor effects share: one effect at work on one image, in float64."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera.sensor import Effect, Exposure
from scenetruth.random_streams import generator_for

Array = NDArray[np.float64]

SHAPE = (300, 400)

NOISY_SENSOR: dict[str, Any] = {
    "photon_rate_per_s": 5e6,
    "exposure_time_s": 0.01,
    "quantum_efficiency": 0.45,
    "full_well_e": 18000.0,
    "gain_dn_per_e": 0.2,
    "bit_depth": 12,
    "black_level_dn": 64.0,
    "temporal_dark_noise_e": 16.0,
    "dark_current_e_per_s": 300.0,
    "dsnu_e": 12.0,
    "prnu": 0.012,
}
"""A sensor of EMVA 1288 with strong fixed patterns, much readout noise and much dark current."""


def applied(
    effect: Effect, signal: Array, *, full_scale: float = 1.0, previous: Array | None = None, s: int = 0
) -> Array:
    """Return what an effect makes of the image of camera position s."""
    shape = (signal.shape[0], signal.shape[1])
    exposure = Exposure(
        s_y=0,
        s=s,
        t=0,
        full_scale=full_scale,
        generator=partial(generator_for, 11, *effect.stream(0, s, 0)),
        pattern=effect.draw_pattern(shape, generator_for(11, "pattern", effect.key)),
        previous=previous,
    )
    return effect.apply(signal, exposure)


def uniform(value: float) -> Array:
    """Return a uniform signal."""
    return np.full(SHAPE, value)


def assert_random(values: Array, mean: float, std: float) -> None:
    """Check mean and standard deviation of independent numbers, each against five of its standard errors."""
    assert values.mean() == pytest.approx(mean, abs=5 * std / np.sqrt(values.size))
    # That of a standard deviation, for numbers that are nearly normal.
    assert values.std() == pytest.approx(std, rel=5 / np.sqrt(2 * values.size))


def assert_converts(effect: Effect, signal: float, expected: float, *, full_scale: float = 1.0) -> None:
    """Check an effect without noise and pattern: its image, its mean response, and the way back."""
    np.testing.assert_allclose(applied(effect, uniform(signal), full_scale=full_scale), expected, rtol=1e-14)
    assert effect.mean_response(signal, full_scale) == pytest.approx(expected, rel=1e-14)
    assert effect.largest_input(expected, full_scale) == pytest.approx(signal, rel=1e-14)

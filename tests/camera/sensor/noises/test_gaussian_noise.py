from __future__ import annotations

import numpy as np

from scenetruth.camera.sensor.noise_sources import GaussianNoise
from tests.sensors import applied, assert_random, uniform


def test_noise_is_as_strong_as_stated_at_any_signal() -> None:
    for signal in (0.0, 0.7):
        noise = applied(GaussianNoise(kind="gaussian_noise", noise_std=0.02), uniform(signal)) - signal
        assert_random(noise, 0.0, 0.02)


def test_two_noises_with_names_are_independent() -> None:
    first, second = (
        applied(GaussianNoise(kind="gaussian_noise", noise_std=1.0, name=name), uniform(0.0)) for name in ("a", "b")
    )
    correlation = np.corrcoef(first.ravel(), second.ravel())[0, 1]
    assert abs(correlation) < 5 / np.sqrt(first.size)

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.camera.sensor.noise_sources import ShotNoise
from tests.sensors import applied, assert_random, uniform


@pytest.mark.parametrize("mean", [40.0, 5000.0, 4e9])
def test_variance_is_the_mean(mean: float) -> None:
    assert_random(applied(ShotNoise(kind="shot_noise"), uniform(mean)), mean, np.sqrt(mean))


def test_electrons_are_counted() -> None:
    drawn = applied(ShotNoise(kind="shot_noise"), uniform(2.5))
    np.testing.assert_array_equal(drawn, np.rint(drawn))
    # The chance of none at all.
    none = np.exp(-2.5)
    assert (drawn == 0).mean() == pytest.approx(none, abs=5 * np.sqrt(none / drawn.size))


def test_no_light_no_noise() -> None:
    assert (applied(ShotNoise(kind="shot_noise"), uniform(-1.0)) == 0).all()


def test_every_image_has_its_own() -> None:
    first, second = (applied(ShotNoise(kind="shot_noise"), uniform(1000.0), s=s).ravel() for s in (0, 1))
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / np.sqrt(first.size)

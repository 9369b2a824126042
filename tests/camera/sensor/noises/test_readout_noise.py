from __future__ import annotations

import numpy as np

from scenetruth.camera.sensor.noise_sources import ReadoutNoise
from tests.sensors import applied, assert_random, uniform


def test_noise_is_as_strong_as_stated_and_anew_in_every_image() -> None:
    effect = ReadoutNoise(kind="readout_noise", temporal_dark_noise_e=6.0)
    first, second = (applied(effect, uniform(100.0), s=s) for s in (0, 1))
    assert_random(first, 100.0, 6.0)
    assert_random(second - first, 0.0, 6.0 * np.sqrt(2))

from __future__ import annotations

import numpy as np

from scenetruth.camera.sensor.noise_sources import PhotoResponseNonuniformity
from tests.sensors import applied, assert_random, uniform


def test_sensitivities_scatter_as_stated_and_stay() -> None:
    effect = PhotoResponseNonuniformity(kind="photo_response_nonuniformity", prnu=0.02)
    image = applied(effect, uniform(5000.0))
    assert_random(image, 5000.0, 100.0)
    np.testing.assert_array_equal(applied(effect, uniform(10000.0), s=3), 2 * image)


def test_no_pixel_gives_negative_signals() -> None:
    strong = PhotoResponseNonuniformity(kind="photo_response_nonuniformity", prnu=0.9)
    assert applied(strong, uniform(1.0)).min() == 0.0

from __future__ import annotations

import numpy as np

from scenetruth.camera.sensor.noise_sources import DarkSignalNonuniformity
from tests.sensors import applied, assert_random, uniform


def test_offsets_scatter_as_stated_and_stay() -> None:
    effect = DarkSignalNonuniformity(kind="dark_signal_nonuniformity", dsnu_e=4.0)
    image = applied(effect, uniform(0.0))
    assert_random(image, 0.0, 4.0)
    np.testing.assert_array_equal(applied(effect, uniform(0.0), s=2), image)

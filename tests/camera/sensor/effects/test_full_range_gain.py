from __future__ import annotations

from scenetruth.camera.sensor.effects import FullScaleGain
from tests.sensors import assert_converts


def test_one_becomes_the_largest_digital_number() -> None:
    assert_converts(FullScaleGain(kind="full_range_gain"), 0.25, 1023.75, full_scale=4095.0)

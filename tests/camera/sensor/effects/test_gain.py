from __future__ import annotations

from scenetruth.camera.sensor.effects import Gain
from tests.sensors import assert_converts


def test_digital_numbers_begin_at_the_black_level() -> None:
    effect = Gain(kind="gain", gain_dn_per_e=0.25, black_level_dn=64.0)
    assert_converts(effect, 1000.0, 314.0)
    assert_converts(effect, 0.0, 64.0)

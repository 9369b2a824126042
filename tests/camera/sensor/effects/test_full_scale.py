from __future__ import annotations

from scenetruth.camera.sensor.effects import RadiometricScale
from tests.sensors import assert_converts


def test_radiance_of_full_scale_becomes_one() -> None:
    assert_converts(RadiometricScale(kind="full_scale", full_scale_radiance=2.5), 1.5, 0.6)

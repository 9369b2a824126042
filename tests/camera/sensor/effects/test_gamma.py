from __future__ import annotations

from scenetruth.camera.sensor.effects import Gamma
from tests.sensors import applied, assert_converts, uniform


def test_response_is_bent_between_its_ends() -> None:
    effect = Gamma(kind="gamma", gamma=0.5)
    assert_converts(effect, 1023.75, 2047.5, full_scale=4095.0)
    assert_converts(effect, 4095.0, 4095.0, full_scale=4095.0)


def test_it_ends_at_black_and_full_scale() -> None:
    effect = Gamma(kind="gamma", gamma=2.0)
    assert (applied(effect, uniform(-5.0), full_scale=255.0) == 0).all()
    assert (applied(effect, uniform(300.0), full_scale=255.0) == 255).all()

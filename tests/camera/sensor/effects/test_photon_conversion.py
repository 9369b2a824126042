from __future__ import annotations

from scenetruth.camera.sensor.effects import PhotonConversion
from tests.sensors import applied, assert_converts, uniform


def test_photons_grow_with_radiance_rate_and_time() -> None:
    effect = PhotonConversion(kind="photon_conversion", photon_rate_per_s=2e6, exposure_time_s=0.01)
    assert_converts(effect, 0.3, 6000.0)


def test_there_are_no_negative_photons() -> None:
    effect = PhotonConversion(kind="photon_conversion", photon_rate_per_s=2e6, exposure_time_s=0.01)
    assert (applied(effect, uniform(-0.01)) == 0).all()

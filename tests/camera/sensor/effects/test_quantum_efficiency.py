from __future__ import annotations

from scenetruth.camera.sensor.effects import QuantumEfficiency
from tests.sensors import assert_converts


def test_some_photons_free_an_electron() -> None:
    assert_converts(QuantumEfficiency(kind="quantum_efficiency", quantum_efficiency=0.6), 5000.0, 3000.0)

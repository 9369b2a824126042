from __future__ import annotations

import numpy as np
import pytest

from scenetruth.camera.sensor.effects import Quantisation
from tests.sensors import applied


@pytest.mark.parametrize("bits", [1, 8, 12, 16])
def test_numbers_are_rounded_and_end(bits: int) -> None:
    effect, top = Quantisation(kind="digitisation", bit_depth=bits), 2.0**bits - 1
    signal = np.array([[-3.0, 0.4, 0.6, top - 0.4, top + 0.6, 1e9]])
    assert applied(effect, signal).tolist() == [[0, 0, 1, top, top, top]]
    assert effect.mean_response(1e9, 1.0) == effect.largest_input(1e9, 1.0) == top


def test_rounding_errors_are_even() -> None:
    # A ramp over many numbers: errors are uniform in [-1/2, 1/2], with the variance 1/12.
    signal = np.linspace(10, 200, 120_000).reshape(300, 400)
    error = applied(Quantisation(kind="digitisation", bit_depth=8), signal) - signal
    assert error.var() == pytest.approx(1 / 12, rel=2e-3)

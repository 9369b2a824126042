from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimate.filters import DERIVATIVE, SMOOTHING, gaussian_window, transfer


def test_filters_reproduce_lines_and_constants() -> None:
    ramp = np.arange(20.0)
    # The derivative of the identity is 1, as far as the coefficients are rounded.
    assert np.convolve(ramp, DERIVATIVE, mode="valid") == pytest.approx(1, abs=1e-12)
    assert SMOOTHING.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("w", [0.05, 0.4, 1.0, 2.0, 3.0])
def test_transfer_functions_against_filtering_a_wave(w: float) -> None:
    wave = np.exp(1j * w * np.arange(-2, 3))
    derivative, smoothing = transfer(w)
    assert np.dot(DERIVATIVE[::-1], wave) == pytest.approx(1j * derivative, abs=1e-15)
    assert np.dot(SMOOTHING[::-1], wave) == pytest.approx(smoothing, abs=1e-15)


def test_gaussian_window_is_symmetric_with_unit_sum_and_the_stated_ratio() -> None:
    window = gaussian_window(6.0, 25)
    assert window.sum() == pytest.approx(1, rel=1e-15)
    assert (window == window[::-1]).all()
    assert window[12 + 6] / window[12] == pytest.approx(np.exp(-0.5), rel=1e-14)

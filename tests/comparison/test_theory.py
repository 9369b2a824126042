"""The built-in methods on cases of the suite, within bounds that follow from theory and not from earlier figures."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.comparison import compare
from scenetruth.comparison.rows import BOUND

METHODS = ["structure_tensor", "refined"]


def test_noise_is_at_the_bound_and_error_bars_are_honest() -> None:
    noise = compare(METHODS, cases=["noise"], values=[0.005])
    for quantity in ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y"):
        bound = noise.figure("noise", BOUND, quantity, "noise").number
        # The confidence interval of the scatter is 12 % on either side: twice that.
        assert 0.76 < noise.figure("noise", "refined", quantity, "noise").number / bound < 1.3
        assert noise.figure("noise", "structure_tensor", quantity, "noise").number > 0.76 * bound
    for method in METHODS:
        for quantity in ("depth", "velocity_x", "velocity_z"):
            found = noise.figure("noise", method, quantity, "calibration").number
            assert 0.76 < found < 1.3, (method, quantity)


def test_a_gaussian_window_leaves_what_it_must() -> None:
    sigma_px, period_px = 6.0, 48.0
    found = compare("structure_tensor", cases=["waves_of_motion"], values=[period_px])
    left = found.figure("waves_of_motion", "structure_tensor", "flow_y", "share_left").number
    # Cut off at two standard deviations, a Gaussian has a variance of 0.774 sigma squared.
    expected = np.exp(-0.774 * sigma_px**2 * (2 * np.pi / period_px) ** 2 / 2)
    # Texture weighs pixels unevenly, here by chance: 5 %.
    assert left == pytest.approx(expected, rel=0.05)


def test_nothing_locks_to_whole_pixels() -> None:
    found = compare(METHODS, cases=["phase_of_disparity"], values=[4.25])
    for method in METHODS:
        # Without noise; splines and derivative filters leave some 1e-4 of a pixel.
        assert abs(found.figure("phase_of_disparity", method, "disparity", "bias", 4.25).number) < 1e-3

"""The built-in methods on cases of the suite, within bounds that follow from theory and not from earlier figures."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.comparison import compare
from scenetruth.comparison.rows import BOUND

METHODS = ["structure_tensor", "refined"]


@pytest.mark.parametrize(
    "quantity", ["depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y"]
)
def test_refined_is_at_the_bound_and_nobody_beyond(noise: Comparison, quantity: str) -> None:
    bound = noise.figure("noise", BOUND, quantity, "noise").number
    found = noise.figure("noise", "refined", quantity, "noise")
    # Three noises over some 8 independent windows leave the scatter known to 12 %: two of these on either side.
    assert 0.76 < found.number / bound < 1.3
    assert noise.figure("noise", "structure_tensor", quantity, "noise").number > 0.76 * bound


def test_error_bars_are_honest(noise: Comparison) -> None:
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
    found = compare(["structure_tensor", "refined"], cases=["phase_of_disparity"], values=[4.25])
    for method in ("structure_tensor", "refined"):
        # Without noise; splines and derivative filters leave some 1e-4 of a pixel.
        assert abs(found.figure("phase_of_disparity", method, "disparity", "bias", 4.25).number) < 1e-3

"""Shifts of maps are measured to a share of a pixel, and their standard errors hold."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from scenetruth.schema import Intrinsics, label
from scenetruth.scoring.convention_check import fit_shift
from scenetruth.scoring.convention_hypotheses import NO_MISMATCH
from scenetruth.scoring.convention_samples import MismatchSamples, read_mismatch_samples

CAMERA = Intrinsics(focal_length_px=100.0, principal_point_px=(31.5, 23.5), baseline_mm=5.0)


def waves(right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """Return the depth of a surface with waves, its map shifted."""
    y, x = np.mgrid[:48, :64].astype(np.float64)
    y, x = y - down, x - right
    depth = 300 + 9 * np.sin(0.21 * x + 0.05 * y) + 7 * np.cos(0.17 * y - 0.04 * x) + 4 * np.sin(0.005 * x * y)
    return np.asarray(depth[np.newaxis])


def material_of(depth: np.ndarray) -> MismatchSamples:
    true = waves()
    still = np.zeros((3, *true.shape))
    maps = {"depth": true, "disparity": 500 / true, "velocity": still, "flow": still[:2], "mixed": true < 0}
    truth = label("truth", maps, CAMERA, t=[0])
    estimate: xr.Dataset = label("estimate", {"depth": depth}, CAMERA, t=[0])
    (material,) = read_mismatch_samples(estimate, truth)
    return material


@pytest.mark.parametrize("right", [-1.0, -0.5, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("down", [-1.0, -0.5, 0.0, 0.5, 1.0])
def test_half_and_whole_pixels_are_told_with_their_signs(right: float, down: float) -> None:
    rng = np.random.default_rng(1)
    # Besides, what is no shift: an offset, a gain, noise and outliers.
    found = 1.01 * waves(right, down) - 2 + 0.3 * rng.standard_normal((1, 48, 64))
    found[rng.random(found.shape) < 0.05] += 40
    fit = fit_shift(material_of(found), NO_MISMATCH)
    assert fit is not None
    assert fit.is_slip == bool(right or down)
    if fit.is_slip:
        assert (fit.right, fit.down) == (right, down)


@pytest.mark.parametrize("length", [0.2, -0.25, 0.3, 0.7, -0.75, 1.3, 1.5, -2.0])
def test_other_shifts_are_not_called_half_or_whole(length: float) -> None:
    rng = np.random.default_rng(2)
    for right, down in ((length, 0.0), (0.0, length), (0.5, length)):
        found = waves(right, down) + 0.3 * rng.standard_normal((1, 48, 64))
        fit = fit_shift(material_of(found), NO_MISMATCH)
        assert fit is None or not fit.is_slip


def test_noise_that_hides_a_shift_leaves_nothing_to_say() -> None:
    rng = np.random.default_rng(3)
    found = waves(1.0, 0.0) + 60 * rng.standard_normal((1, 48, 64))
    fit = fit_shift(material_of(found), NO_MISMATCH)
    assert fit is None or not fit.is_slip

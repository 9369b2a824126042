"""Growth of the plain and of the affine model: what differs by more than noise, and what noise may hide."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import scenetruth as st
from scenetruth.estimators.refined import RATES, Fit, GrowthComparison, blank_fit, compare_growth
from scenetruth.schema.variables import MOTION_AFFINE, MOTION_PLAIN
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane, turning

Array = NDArray[np.float64]

SIGMA_PX, SHAPE = 3.0, (150, 180)
PLAIN_STD, ADDED_STD = 1e-5, 7e-5
GROWTH = 7


def fits(bias: Array | float, seed: int = 0) -> tuple[Fit, Fit]:
    """Return a plain and an affine fit whose noise is that of windows, with a bias of the plain growth in `ADDED_STD`.

    Weighted means over windows of σ have a correlation of exp(-r² / 4σ²).
    """
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(4, *SHAPE)), SIGMA_PX, axes=(1, 2), mode="wrap")
    noise *= ADDED_STD / noise.std()
    plain, affine = (blank_fit(np.zeros((15, *SHAPE)), variances=True) for _ in range(2))
    for fit, variance in ((plain, PLAIN_STD**2), (affine, PLAIN_STD**2 + ADDED_STD**2)):
        fit.theta[0] = 8.0
        fit.variance[:] = 1e-4
        fit.element[:], fit.element_variance[:] = 0.0, variance
    affine.element[RATES] = noise
    plain.element[GROWTH] = np.asarray(bias) * ADDED_STD
    return plain, affine


def compared(bias: Array | float, among: NDArray[np.bool_] | None = None) -> GrowthComparison:
    among = np.ones(SHAPE, dtype=np.bool_) if among is None else among
    return compare_growth(*fits(bias), SIGMA_PX, among, 1.0)


def hidden(found: GrowthComparison) -> Array:
    """Return the bias of growth in `ADDED_STD`."""
    return np.asarray(np.sqrt(found.bias[3]) / ADDED_STD)


def test_noise_is_not_significant() -> None:
    """And the bias it may hide is less than half of it: some 300 windows know the mean square to a tenth."""
    found = compared(0.0)
    assert found.significant.mean() < 0.01
    assert 0.1 < np.median(hidden(found)) < 0.6


@pytest.mark.parametrize("bias", [0.5, 1.0, -3.0])
def test_bias_is_significant_or_stated(bias: float) -> None:
    """The largest of the biases at three scales is stated: rather too much than too little."""
    found = compared(bias)
    assert 0.9 < np.median(hidden(found)) / abs(bias) < 1.6
    # The error of the plain fit in units of what it states.
    stated = np.where(found.significant, 1.0, np.hypot(hidden(found), PLAIN_STD / ADDED_STD))
    wrong = np.where(found.significant, 0.0, abs(bias) / stated)
    assert np.sqrt(np.mean(wrong**2)) < 1.3
    # It is taken where it errs by more than the noise of the affine model.
    assert (found.significant.mean() > 0.98) if abs(bias) > 2 else (found.significant.mean() < 0.8)


def test_weak_bias_of_a_whole_surface_is_stated_and_little_more() -> None:
    """The mean of 75 windows has a standard deviation of 0.12, and its square is known far better than mean squares."""
    surface, stated = np.ones(SHAPE, dtype=np.bool_), {}
    for bias in (0.0, 0.35):
        each = [hidden(compare_growth(*fits(bias, seed), SIGMA_PX, surface, 1.0)) for seed in range(3)]
        stated[bias] = np.array(each)
    assert np.median(stated[0.0]) < 0.2
    error = 0.35 / np.hypot(stated[0.35], PLAIN_STD / ADDED_STD)
    assert np.sqrt(np.mean(error**2)) < 1.3
    assert 0.7 < np.median(stated[0.35]) / 0.35 < 1.4


def test_bias_that_changes_its_sign_is_seen() -> None:
    """As on a saddle, whose tilt changes: its mean is zero, its square is not."""
    sides = np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, 3.0, -3.0)
    assert compared(np.broadcast_to(sides, SHAPE)).significant.mean() > 0.98


def test_surfaces_are_compared_by_themselves() -> None:
    """A small one that grows, in a large one that does not; between them is what both windows see, as the nearest."""
    leaf, gap = np.zeros(SHAPE, dtype=np.bool_), np.zeros(SHAPE, dtype=np.bool_)
    leaf[50:90, 60:110], gap[46:94, 56:114] = True, True
    found = compared(np.where(gap, 4.0, 0.0), ~gap | leaf)
    assert found.significant[leaf].mean() > 0.98
    assert found.significant[~leaf].mean() < 0.01
    assert np.median(hidden(found)[~gap]) < 0.6
    assert hidden(found)[49, 80] == pytest.approx(4.0, rel=0.4)


def test_exact_images_leave_the_error_of_interpolation() -> None:
    """Without noise all would differ: the same image shift as for velocity is below it."""
    plain, affine = fits(0.0)
    for fit in (plain, affine):
        fit.variance[:] *= 1e-8
        fit.element_variance[:] *= 1e-8
    found = compare_growth(plain, affine, SIGMA_PX, np.ones(SHAPE, dtype=np.bool_), 1.0)
    assert found.significant.mean() > 0.9
    affine.element[RATES] *= 1e-4
    # An image shift of 2.5e-4 px is 3 standard deviations of q_X here.
    affine.variance[3] = (2.5e-4 / 8.0 / 3.0) ** 2
    found = compare_growth(plain, affine, SIGMA_PX, np.ones(SHAPE, dtype=np.bool_), 1.0)
    assert found.significant.mean() < 0.01


@nightly
def test_turning_planes_that_grow_along_one_side() -> None:
    """Isotropic growth is biased on a slope, also where disparity and velocity hardly change."""
    tangents = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2]])
    along = np.outer(tangents[0], np.linalg.pinv(tangents)[:, 0])
    plane = MovingPlane(gradient=0.006 * along + turning(1e-3, 2e-3, -1e-3))
    recording = plane.recording(noise_std=0.003, seed=3)
    inner = {"t": 0, "y": slice(14, -14), "x": slice(30, -30)}
    exact = plane.truth()["growth_rate"][14:-14, 30:-30]
    errors, std = {}, np.zeros(())
    for motion in ("auto", "growing"):
        found = st.estimate(
            recording, "refined", window_sigma_px=4.0, motion=motion, acceleration=False, discontinuity_refit=False
        ).isel(inner)
        if motion == "auto":
            std = found["growth_rate_std"].values
            model = found["motion_model"].values
            assert np.mean(model == MOTION_AFFINE) > 0.9
            assert np.isin(model, (MOTION_PLAIN, MOTION_AFFINE)).all()
        errors[motion] = np.median(np.abs(found["growth_rate"].values - exact) / std)
    assert errors["growing"] > 1.8 * errors["auto"]
    assert errors["auto"] < 1.2

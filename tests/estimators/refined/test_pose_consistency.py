"""Pose errors that are not stated: seen where they are, with their size, and added to the standard deviations."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import maximise_likelihood
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
PLANE = MovingPlane(size=(80, 112))
CAMERAS, FRAMES, NOISE = 5, 3, 0.01
SETTINGS = {"window_sigma_px": 4.0, "window_frames": FRAMES, "surface": "plane", "discontinuity_refit": False}


def test_variances_of_two_groups() -> None:
    """Eighty and forty unknowns, observed with unit information and unit noise: their variances within a third."""
    generator = np.random.default_rng(0)
    group = np.repeat([0, 1], [80, 40])
    true = np.where(group == 0, 3.0, 0.0)
    side = 25.0 * generator.normal(0.0, 1.0, 120) * true + 5.0 * generator.normal(0.0, 1.0, 120)
    variance, unknown, gain, seen = maximise_likelihood(25.0 * np.eye(120), side, group, np.full(2, 0.5))
    assert np.sqrt(variance[0]) == pytest.approx(3.0, rel=0.33)
    assert np.sqrt(variance[1]) < 0.2
    assert gain > 100
    assert seen[0] == pytest.approx(80, rel=0.05)
    assert np.abs(unknown[group == 1]).max() < 0.6


def test_undetermined_directions_stay_finite() -> None:
    """Two unknowns of which images see only the sum, with rounding errors, at the precision of images without noise."""
    matrix = 1e12 * np.array([[1.0, 1.0], [1.0, 1.0 - 1e-13]])
    side = 1e12 * np.array([1.0, 1.0 + 1e-9])
    variance, unknown, gain, seen = maximise_likelihood(matrix, side, np.zeros(2, dtype=np.intp), np.full(1, 0.5))
    assert np.isfinite([*variance, *unknown, gain, *seen]).all()
    # The direction of the sum is that of eigenvectors of a matrix with a relative rounding of 1e-13 over 1e-9.
    assert unknown == pytest.approx([0.5, 0.5], rel=1e-3)


def test_displaced_positions_are_seen_and_stated() -> None:
    generator = np.random.default_rng(3)
    off = np.repeat(generator.normal(0, 1, (CAMERAS, 1, 4)) * [0.05, 0.05, 1e-4, 1e-4], FRAMES, axis=1)
    recording = PLANE.recording(CAMERAS, FRAMES, noise_std=NOISE, moved=off)
    with pytest.warns(st.EstimateWarning, match="displaced against each other by about 0"):
        found = st.estimate(recording, "refined", SETTINGS).sel(t=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trusted = st.estimate(recording, "refined", SETTINGS, pose_corrections="none").sel(t=0)
    truth = PLANE.truth()["disparity"]
    inner = (slice(20, -20), slice(28, -28))
    z = [(each["disparity"].values - truth)[inner] / each["disparity_std"].values[inner] for each in (found, trusted)]
    assert np.abs(z[1]).mean() > 3
    assert np.abs(z[0]).mean() < 2


def test_good_recordings_are_not_suspected() -> None:
    recording = PLANE.recording(CAMERAS, FRAMES, noise_std=NOISE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, trusted = (
            st.estimate(recording, "refined", SETTINGS, pose_corrections=each).sel(t=0) for each in ("auto", "none")
        )
    np.testing.assert_array_equal(found["disparity_std"].values, trusted["disparity_std"].values)


def _stated(ratio: float, visit_px: float, seed: int) -> tuple[list[str], Array]:
    """Return the warnings of a recording with errors beyond the priors, and disparity and velocity_x in σ."""
    generator = np.random.default_rng(seed)
    fixed = ratio * generator.normal(0, 1, (CAMERAS, 1, 4)) * [0.05, 0.05, 1e-4, 0.0]
    off = np.repeat(fixed, FRAMES, axis=1)
    off[..., :2] += visit_px * generator.normal(0, 1, (CAMERAS, FRAMES, 2))
    recording = PLANE.recording(CAMERAS, FRAMES, noise_std=NOISE, moved=off - off[CAMERAS // 2, FRAMES // 2])
    priors = {"x_px": 0.05, "y_px": 0.05, "roll_urad": 100.0}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = st.estimate(recording, "refined", SETTINGS, pose_corrections=priors).sel(t=0)
    truth = PLANE.truth()
    z = [
        (found["disparity"].values - truth["disparity"]) / found["disparity_std"].values,
        (found["velocity"].values[0] - truth["velocity"][0]) / found["velocity_std"].values[0],
    ]
    return [str(each.message) for each in caught], np.stack(z)[:, 20:-20, 28:-28]


def test_stated_errors_are_compared_with_the_images() -> None:
    warned, z = _stated(1.0, 0.0, 3)
    assert not warned
    assert (np.abs(z) < 3).mean() > 0.95


@nightly
def test_errors_beyond_those_stated_enlarge_standard_deviations() -> None:
    draws = [_stated(4.0, 0.0, seed) for seed in (3, 4, 5)]
    assert all("times the stated errors" in warned[0] for warned, _ in draws)
    assert np.mean([(np.abs(z) < 2).mean() for _, z in draws]) > 0.85


@nightly
def test_displaced_visits_that_are_not_stated() -> None:
    draws = [_stated(1.0, 0.05, seed) for seed in (3, 4, 5)]
    assert all("single images by about 0.0" in warned[0] for warned, _ in draws)
    assert np.mean([(np.abs(z) < 2).mean() for _, z in draws]) > 0.85


@nightly
def test_unsteady_motion_of_the_whole_view_is_not_an_error_of_poses() -> None:
    """All cameras of a frame are displaced alike: 0.3 px from frame to frame, of which no stated pose is the cause."""
    frames = 7
    generator = np.random.default_rng(4)
    off = np.zeros((CAMERAS, frames, 4))
    off[..., :2] = 0.3 * generator.normal(0, 1, (1, frames, 2))
    recording = PLANE.recording(CAMERAS, frames, noise_std=NOISE, moved=off - off[:, [frames // 2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, trusted = (
            st.estimate(recording, "refined", SETTINGS | {"window_frames": frames}, pose_corrections=each).sel(t=0)
            for each in ("auto", "none")
        )
    np.testing.assert_array_equal(found["depth_std"].values, trusted["depth_std"].values)

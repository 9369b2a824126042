"""Motion is as rich as disparity and velocity need."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import (
    MotionModelTrial,
    between,
    blank_fit,
    choose_motion_model,
    every_other,
    find_remainders,
    with_bias,
)
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART, MOTION_AFFINE, MOTION_PLAIN
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]

SIGMA_PX = 4.0
# All cameras and frames see these pixels, with their windows.
ROWS, COLUMNS = slice(14, -14), slice(34, -34)
NOISE_STD = 0.002
# Shear and expansion that no turn and no even growth makes, per frame.
SHEAR = 0.004 * np.array([[1.0, 0.75, 0.0], [0.75, -1.0, 0.0], [0.0, 0.0, 0.0]])
# Of 4 quantities in some 10 windows beside each other, the mean square varies by 0.2.
SCATTER = 0.3


def estimated(recording: xr.Dataset, **settings: Any) -> xr.Dataset:
    return st.estimate(recording, method="refined", window_sigma_px=SIGMA_PX, discontinuity_refit=False, **settings)


def inner(found: xr.Dataset) -> xr.Dataset:
    return found.isel(t=0, y=ROWS, x=COLUMNS)


def scaled(found: xr.Dataset, depth: Array, velocity: Array) -> Array:
    """Errors of depth and velocity over their standard deviations."""
    inside = inner(found)
    errors = [(inside["depth"].values - depth[ROWS, COLUMNS]) / inside["depth_std"].values]
    errors += list((inside["velocity"].values - velocity[:, ROWS, COLUMNS]) / inside["velocity_std"].values)
    return np.stack(errors)


def motion_of(found: xr.Dataset) -> Array:
    return np.asarray(inner(found)["motion_model"].values)


def test_single_pixels_with_a_simpler_model_than_all_around_are_not_trusted() -> None:
    """Two halves with different models and a corner are regions; single pixels and the edge of the images are not."""
    which = np.zeros((60, 80), dtype=np.int8)
    which[:, 40:] = 2
    which[:30, :40] = 2
    known = np.ones(which.shape, dtype=np.bool_)
    assert not find_remainders(which, [2], known, SIGMA_PX).any()
    spots = which.copy()
    spots[20, 60], spots[10:12, 20] = 0, 1
    spots[45, 10] = 2
    known[:, 78:] = False
    spots[30, 77] = 0
    found = find_remainders(spots, [2], known, SIGMA_PX)
    assert np.argwhere(found).tolist() == [[10, 20], [11, 20], [20, 60], [30, 77]]


@nightly
@pytest.mark.parametrize("motion", ["auto", *by_night("growing")])
def test_a_plane_that_grows_evenly_is_plain(motion: str) -> None:
    """Any gradient and an acceleration change by noise alone what rotation and growth find."""
    plane = MovingPlane(gradient=0.004 * np.eye(3))
    found = estimated(plane.recording(noise_std=NOISE_STD, seed=1), motion=motion)
    assert np.mean(motion_of(found) == MOTION_PLAIN) > 0.98
    plain = estimated(plane.recording(noise_std=NOISE_STD, seed=1), motion="growing", acceleration=False)
    same = motion_of(found) == MOTION_PLAIN
    for name in ("depth", "velocity", "growth_rate"):
        one, other = (inner(each)[name].values[..., same] for each in (found, plain))
        np.testing.assert_array_equal(one, other)


@nightly
@pytest.mark.parametrize(("times", "seed"), [(3, 2), (7, 2), (10, 2), (10, 5)])
def test_shear_takes_any_gradient(times: int, seed: int) -> None:
    """A turn and even growth take shear for curvature and motion in depth: 4 % per frame, and 36 % over all frames."""
    plane = MovingPlane(gradient=times * SHEAR, velocity_mm=(0.05, -0.03, 0.0))
    recording = plane.recording(noise_std=NOISE_STD, seed=seed)
    exact = plane.truth()["depth"], plane.truth()["velocity"]
    found, fixed = estimated(recording), estimated(recording, motion="growing")
    assert np.mean(motion_of(found) == MOTION_AFFINE) > 0.95
    assert np.sqrt(np.mean(scaled(found, *exact) ** 2)) < 1.0 + SCATTER
    # Standard deviations of the wrong model include part of its error.
    with np.errstate(invalid="ignore"):
        assert np.sqrt(np.nanmean(scaled(fixed, *exact) ** 2)) > 2.0


@nightly
def test_an_even_acceleration_is_found() -> None:
    """All frames agree with it, so that all are used."""
    plane = MovingPlane(acceleration_mm=(0.01, -0.015, 0.04))
    found = estimated(plane.recording(noise_std=NOISE_STD, seed=3))
    truth = plane.truth()
    assert np.mean(motion_of(found) == MOTION_ACCELERATED) > 0.9
    assert np.sqrt(np.mean(scaled(found, truth["depth"], truth["velocity"]) ** 2)) == pytest.approx(1.0, abs=SCATTER)
    assert "acceleration" not in found


class Swinging(MovingPlane):
    """A plane that swings to and fro in depth: 1 - cos ωt, in mm."""

    amplitude_mm, per_frame = 6.0, np.pi / 8

    def image(self, stage_mm: tuple[float, float], t: float, channel: int = 0, moved: Array | None = None) -> Array:
        away = self.amplitude_mm * (1.0 - np.cos(self.per_frame * t))
        still = MovingPlane(velocity_mm=(0.0, 0.0, away), wavelengths_px=self.wavelengths_px, size=self.size)
        return still.image(stage_mm, 1.0, channel, moved)


@nightly
def test_fewer_frames_are_used_where_all_do_not_agree() -> None:
    """Over 9 frames, half a period, a parabola errs by more than noise; over 3 it does not.

    1 - cos ωt less ½ ω² t² is about -ω⁴ t⁴ / 24: of 6 mm, 1.4 mm at t = 4, 0.006 mm at t = 1.
    """
    plane = Swinging(velocity_mm=(0.0, 0.0, 0.0))
    recording = plane.recording(noise_std=NOISE_STD, seed=4)
    truth = MovingPlane(velocity_mm=(0.0, 0.0, 0.0)).truth()
    exact = truth["depth"], truth["velocity"]
    found = estimated(recording)
    assert np.mean(motion_of(found) == MOTION_ACCELERATED_IN_PART) > 0.9
    assert inner(found)["image_count"].values.max() <= 25
    assert np.sqrt(np.mean(scaled(found, *exact) ** 2)) < 1.0 + SCATTER
    over_all = estimated(recording, acceleration=True, max_residual_ratio=100)
    off, off_over_all = (inner(each)["depth"].values - exact[0][ROWS, COLUMNS] for each in (found, over_all))
    assert np.sqrt(np.nanmean(off_over_all**2)) > 3 * np.sqrt(np.mean(off**2))


def test_what_smaller_windows_change_tells_the_bias() -> None:
    """Of a parabola, windows find the value at its top and a bias that goes with their variance: b σ²."""
    shape = (40, 50)
    fine, coarse = (blank_fit(np.zeros((15, *shape)), variances=True) for _ in range(2))
    fine.theta[0], coarse.theta[0] = 1.0 + 0.01 * 2.0**2, 1.0 + 0.01 * 3.0**2
    for fit, variance in ((fine, 4e-6), (coarse, 1e-6)):
        fit.variance[:] = variance
    found = with_bias(fine, coarse, 2.0, 3.0)
    # The difference of 0.05 holds noise of 3e-6, too.
    expected = 4e-6 + (4.0 / 5.0) ** 2 * (0.05**2 - 3e-6)
    np.testing.assert_allclose(found.variance[0], expected, rtol=1e-6)
    assert expected == pytest.approx(0.04**2, rel=0.01)
    # What is the same in both has no bias.
    np.testing.assert_allclose(found.variance[3:6], 4e-6)


def test_every_other_pixel_tells_of_its_neighbours() -> None:
    """Of images with odd numbers of rows and columns too."""
    theta = np.arange(15 * 5 * 7, dtype=np.float64).reshape(15, 5, 7)
    thinned = every_other(blank_fit(theta, variances=True))
    np.testing.assert_array_equal(thinned.theta, theta[:, ::2, ::2])
    found = between(thinned.theta[0] > 10, (5, 7))
    assert found.shape == (5, 7)
    np.testing.assert_array_equal(found[::2, ::2], thinned.theta[0] > 10)
    np.testing.assert_array_equal(found[1::2], found[:-1:2])


def test_a_trial_is_released_before_the_next_one_is_fitted() -> None:
    shape = (20, 24)
    held: list[weakref.ref[Any]] = []

    def trials() -> Iterator[MotionModelTrial]:
        for _ in range(3):
            assert all(one() is None for one in held)
            trial = [MotionModelTrial(blank_fit(np.zeros((15, *shape)), variances=True), True, lambda _: None)]
            held.append(weakref.ref(trial[0].fit.theta))
            yield trial.pop()

    plain, where = blank_fit(np.zeros((15, *shape)), variances=True), [np.zeros(shape, dtype=bool)] * 3
    _, which = choose_motion_model(plain, trials(), where, 2.0, 1.0)
    assert len(held) == 3
    assert not which.any()

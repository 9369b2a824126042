"""Velocities of two or three frames are tested with the frames beyond: errors are stated, or the pixels are invalid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as some
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import choose_frames_beyond, derivative_weights
from scenetruth.indexing import centred_indices
from scenetruth.schema import REASONS
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]

NOISE_STD = 0.003
PLANE = MovingPlane(size=(64, 80), velocity_mm=(0.3, -0.1, 0.2), slopes=(0.1, -0.05))
SETTINGS = {"window_frames": 3, "window_sigma_px": 4, "fallback": "none", "surface": "plane", "motion": "translation"}


@given(
    fitted=some.sampled_from([(0.0, 1.0), (-1.0, 0.0, 1.0), (-1.0, 0.0)]),
    beyond=some.sampled_from([(2.0, 3.0), (-2.0, 2.0), (2.5,), (-3.0, -2.0)]),
    factors=some.lists(some.floats(-2.0, 2.0), min_size=2, max_size=2),
    derivative=some.sampled_from([1, 2]),
)
def test_weights_return_the_derivative_of_a_polynomial_that_is_zero_at_the_fitted_times(
    fitted: tuple[float, ...], beyond: tuple[float, ...], factors: list[float], derivative: int
) -> None:
    deviation = Polynomial.fromroots(fitted) * Polynomial(factors[: len(beyond)])
    found = derivative_weights(fitted, beyond, derivative) @ deviation(np.array(beyond))
    assert found == pytest.approx(deviation.deriv(derivative)(0.0), abs=1e-9)


@given(
    factors=some.lists(some.floats(-1.0, 1.0), min_size=5, max_size=5),
    reach=some.sampled_from([2, 3]),
    derivative=some.sampled_from([1, 2]),
)
def test_weights_return_the_error_of_a_parabola_by_least_squares(
    factors: list[float], reach: int, derivative: int
) -> None:
    """Positions are a polynomial of fourth order; least squares by numpy."""
    position, times = Polynomial(factors), np.arange(-reach, reach + 1.0)
    fit = Polynomial.fit(times, position(times), 2).convert()
    beyond = np.array([-reach - 1.0, reach + 1.0])
    deviations = position(beyond) - position(0.0) - (fit(beyond) - fit(0.0))
    error = position.deriv(derivative)(0.0) - fit.deriv(derivative)(0.0)
    assert derivative_weights(times, beyond, derivative) @ deviations == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ((-3, -2, -1, 0, 1, 2, 3), [-2, 2]),
        ((-1, 0, 1, 2, 3, 4), [2, 3]),
        ((-3, -2, -1, 0, 1), [-2, -3]),
        ((-1, 0, 1, 2), [2]),
        ((-1, 0, 1), []),
    ],
)
def test_frames_beyond_are_the_nearest_on_both_sides_or_two_on_one(times: tuple[int, ...], expected: list[int]) -> None:
    frames = np.array(times, dtype=np.float64)
    chosen = choose_frames_beyond(frames, np.array([-1.0, 0.0, 1.0]))
    assert frames[chosen].tolist() == expected


def recorded(place: Callable[[float], float], frames: int, cameras: int = 3, seed: int = 1) -> xr.Dataset:
    """Record a plane that moves along its velocity by a function of time, 0 in the middle frame."""
    images = np.array(
        [
            [PLANE.image((x_mm, 0.0), place(t)) for t in centred_indices(frames)]
            for x_mm in PLANE.baseline_mm * centred_indices(cameras)
        ]
    )
    images += np.random.default_rng(seed).normal(0.0, NOISE_STD, images.shape)
    return st.make_recording(images, PLANE.focal_px, PLANE.baseline_mm)


def estimated(recording: xr.Dataset, **settings: Any) -> xr.Dataset:
    return st.estimate(recording, "refined", {**SETTINGS, **settings}).sel(t=0)


def scaled_errors(found: xr.Dataset, factor: float) -> Array:
    """Return the errors of the velocity along X and Y in standard deviations, at valid pixels, shape (2, n)."""
    valid = found["status"].values == 2
    off = found["velocity"].values[:2] - factor * np.array(PLANE.velocity_mm)[:2, None, None]
    return np.asarray((off / found["velocity_std"].values[:2])[:, valid])


@nightly
@pytest.mark.parametrize("acceleration", [True, *by_night("auto", False)])
@pytest.mark.parametrize(("period", "phase"), [(6.0, 0.4), *by_night((5.0, 0.0), (8.0, 1.0))])
def test_velocities_of_three_frames_of_a_swing_have_their_systematic_error(
    period: float, phase: float, acceleration: Any
) -> None:
    """Over t = -1, 0 and 1 the velocity is smaller by sin(ω) / ω, whatever the acceleration."""
    omega = 2 * np.pi / period
    swing = recorded(lambda t: float(np.sin(omega * t + phase) - np.sin(phase)) / omega, 5)
    found = estimated(swing, acceleration=acceleration)
    assert (found["status"] == 2).mean() > 0.8
    errors = scaled_errors(found, np.cos(phase))
    # Stated errors are 1.4 times the third order, of which that of these motions is 0.7 to 1.
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.3
    assert np.abs(errors).max() < 6.0
    # Nothing in three frames shows it if all of the motion may be an acceleration.
    alone = estimated(swing.isel(t=slice(1, 4)), acceleration=True)
    assert np.sqrt(np.mean(scaled_errors(alone, np.cos(phase)) ** 2)) > 4.0


@nightly
def test_steady_velocities_keep_their_standard_deviation() -> None:
    steady = recorded(lambda t: t, 5)
    found, alone = estimated(steady), estimated(steady.isel(t=slice(1, 4)))
    valid = (found["status"].values == 2) & (alone["status"].values == 2)
    assert valid.sum() >= 0.98 * (alone["status"] == 2).sum()
    ratio = (found["velocity_std"] / alone["velocity_std"]).values[:, valid]
    assert np.median(ratio) < 1.05
    assert np.sqrt(np.mean(scaled_errors(found, 1.0) ** 2)) == pytest.approx(1.0, abs=0.15)


@nightly
@pytest.mark.parametrize("broken", [[0], *by_night([4])])
def test_a_frame_beyond_of_something_else_does_not_matter_if_the_other_one_fits(broken: list[int]) -> None:
    steady = recorded(lambda t: t, 5).copy(deep=True)
    other = replace(PLANE, seed=9).image((0.0, 0.0), 0.0)
    steady["image"].values[:, broken] = other
    found = estimated(steady)
    assert (found["status"] == 2).mean() > 0.8
    assert np.abs(scaled_errors(found, 1.0)).max() < 6.0


@nightly
def test_motion_that_no_frame_beyond_shows_is_a_model_violation() -> None:
    moved = recorded(lambda t: t, 5).copy(deep=True)
    for frame in (0, 4):
        moved["image"].values[:, frame] = replace(PLANE, seed=9 + frame).image((0.0, 0.0), 0.0)
    found = estimated(moved)
    assert (found["status"] == 2).mean() < 0.02
    reasons = found["invalid_reason"].values[found["status"].values == 0]
    assert np.mean(reasons == REASONS.index("model_violation")) > 0.8


def test_frames_that_are_excluded_as_a_whole_may_show_a_motion() -> None:
    """The camera is not moved: all images of the last frames show another place."""
    fast = recorded(lambda t: t if t < 3 else t + 20.0, 9)
    with pytest.warns(st.EstimateWarning, match="reduce window_frames"):
        estimated(fast, window_frames=9)

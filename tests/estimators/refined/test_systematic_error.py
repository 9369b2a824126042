"""Errors of a motion that is not steady, of curved windows and of two cameras are stated, or the pixels are invalid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

import scenetruth as st
from scenetruth.estimators.refined import (
    ImageStack,
    SystematicErrors,
    add_contradiction,
    blank_fit,
    change_at_scales,
    extrapolation_share,
    find_likely_changes,
    find_open_blanks,
    is_supported,
    is_surrounded,
    list_spans,
    polynomial_bias,
    sees_second_camera,
    spline_transfer,
)
from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]

NOISE_STD = 0.003
# Period in frames, amplitude in mm, phase.
SWING = 10.0, np.array([0.3, 0.0, 1.0]), 0.7
WEAK = 9.4, np.array([-0.004, -0.041, 0.114]), 5.6


def stack(cameras: int, times: Array, shape: tuple[int, int] = (20, 40)) -> ImageStack:
    """Images without content of cameras one step apart."""
    positions = np.stack([np.arange(cameras, dtype=np.float64), np.zeros(cameras)], axis=-1)
    blank = [np.zeros((1, cameras, *shape), dtype=np.float32)] * len(times)
    return ImageStack(blank, positions, times, 1000.0, (20.0, 10.0), np.zeros((cameras * len(times), 4)))


@pytest.mark.parametrize("reach", [1, 2, 4])
def test_errors_of_a_fit_follow_from_powers_of_time(reach: int) -> None:
    t = np.arange(-reach, reach + 1.0)
    position, velocity = polynomial_bias(t, 2, accelerated=False)
    assert position == pytest.approx(np.mean(t**2) / 2)
    assert velocity == pytest.approx(0.0, abs=1e-12)
    position, velocity = polynomial_bias(t, 3, accelerated=False)
    assert position == pytest.approx(0.0, abs=1e-12)
    assert velocity == pytest.approx(np.sum(t**4) / np.sum(t**2) / 6)


@pytest.mark.parametrize("period", [14.0, 20.0, 50.0])
@pytest.mark.parametrize(("longer", "shorter"), [(4, 2), (2, 1)])
def test_the_change_between_two_spans_extrapolates_to_the_error(period: float, longer: int, shorter: int) -> None:
    """Least squares over a harmonic motion have a closed form: velocity and mean position at time 0."""
    omega = 2 * np.pi / period

    def fitted(reach: int) -> Array:
        t = np.arange(-reach, reach + 1.0)
        return np.array([np.mean(np.cos(omega * t)), np.sum(t * np.sin(omega * t)) / np.sum(t**2)])

    true = np.array([1.0, omega])
    spans = [np.arange(-reach, reach + 1.0) for reach in (longer, shorter)]
    stated = extrapolation_share(*spans, accelerated=False) * np.abs(fitted(longer) - fitted(shorter))
    ratio = stated / np.abs(fitted(longer) - true)
    assert np.all((ratio > 0.7) & (ratio < 1.15))


def test_spans_are_halved_to_the_adjacent_frames() -> None:
    assert [len(part.times) for part in list_spans(stack(2, np.arange(-4.0, 5.0)))] == [9, 5, 3]
    assert [len(part.times) for part in list_spans(stack(2, np.arange(0.0, 4.0)))] == [4, 3, 2]
    assert [len(part.times) for part in list_spans(stack(2, np.zeros(1)))] == [1]


def oscillating(
    period: float, amplitude_mm: Array, phase: float, seed: int, size: tuple[int, int] = (48, 72)
) -> tuple[xr.Dataset, Array]:
    """A plane that moves to and fro, and its velocity at the estimated frame."""
    plane = MovingPlane(size=size, slopes=(0.1, -0.1), waves=16 if size[0] < 100 else 40)
    omega = 2 * np.pi / period
    images = np.empty((3, 9, *plane.size))
    for i, x_mm in enumerate(plane.baseline_mm * centred_indices(3)):
        for j, t in enumerate(centred_indices(9)):
            moved = amplitude_mm * (np.sin(omega * t + phase) - np.sin(phase))
            rate = tuple(moved / t) if t else (0.0, 0.0, 0.0)
            images[i, j] = replace(plane, velocity_mm=rate).image((x_mm, 0.0), t)
    images += np.random.default_rng(seed).normal(0.0, NOISE_STD, images.shape)
    return make_recording(images, plane.focal_px, plane.baseline_mm), amplitude_mm * omega * np.cos(phase)


def scores(swing: tuple[float, Array, float], seed: int, size: tuple[int, int] = (48, 72)) -> Array:
    """Return errors of the valid velocities in units of their stated standard deviations, shape (3, n)."""
    recording, velocity = oscillating(*swing, seed, size)
    # Otherwise, the unsteady motion of the whole image would count as errors of the poses, too.
    settings = {"discontinuity_refit": False, "pose_corrections": "none"}
    found = st.estimate(recording, "refined", settings).isel(t=0)
    valid = found["status"].values == 2
    assert valid.mean() > 0.3
    error = found["velocity"].transpose("component", "y", "x").values - velocity[:, None, None]
    return np.asarray(error[:, valid] / found["velocity_std"].transpose("component", "y", "x").values[:, valid])


def test_the_error_of_an_unsteady_motion_is_stated() -> None:
    for component, z in zip("XYZ", np.abs(scores(SWING, 2)), strict=True):
        assert np.mean(z > 6) < 0.02, component
        assert np.mean(z < 2) > 0.85, component


def test_a_weak_change_of_a_whole_surface_is_seen_and_that_of_a_few_pixels_does_not_spread() -> None:
    """Noise of 1 that is correlated as between windows of 2 nodes; a change by 0.8 everywhere or by 300 at four nodes.

    The usual mean has a noise of 0.45, which hides the change: 2.5 of it are 1.1; that over 16 nodes has 0.12.
    """
    drawn = ndimage.gaussian_filter(np.random.default_rng(4).normal(0.0, 1.0, (80, 80)), 2.0)
    noise = drawn / drawn.std()
    among, variance = np.ones(noise.shape, dtype=np.bool_), np.ones((1, *noise.shape))
    (still,), *_ = change_at_scales(noise[None], variance, among, 2.0, 0.2)
    (moved,), *_ = change_at_scales(noise[None] + 0.8, variance, among, 2.0, 0.2)
    assert still.mean() < 0.05
    assert np.mean(moved > 0.0) > 0.95
    assert np.median(np.sqrt(moved)) == pytest.approx(0.8, abs=0.3)
    few = noise.copy()
    few[40:42, 40:42] += 300.0
    (spread,), *_ = change_at_scales(few[None], variance, among, 2.0, 0.2)
    assert spread[40, 40] > 100.0
    assert spread[:, :8].max() < 1.0


@pytest.mark.parametrize(("hidden", "stated"), [(0.0, (0.0, 0.6)), (0.7, (0.7, 1.05)), (2.0, (2.0, 2.3))])
def test_changes_that_noise_hides_are_stated_on_average(hidden: float, stated: tuple[float, float]) -> None:
    """Ten draws of noise of 1 that is correlated as between windows of 2 nodes, with a mean noise of 0.45 or less.

    The squares of noise alone at the three scales add up to at most 0.27, 0.52², and 15 % more by the scatter.
    """
    among, variance = np.ones((60, 60), dtype=np.bool_), np.ones((1, 60, 60))
    squares = []
    for seed in range(10):
        drawn = ndimage.gaussian_filter(np.random.default_rng(seed).normal(0.0, 1.0, among.shape), 2.0)
        squares.append(find_likely_changes(drawn[None] / drawn.std() + hidden, variance, among, 2.0, 0.2).mean())
    assert stated[0] < np.sqrt(np.mean(squares)) < stated[1]


SWINGS = [
    (5.6, np.array([-0.0018, -0.0022, -0.0011]), 2.34),
    (13.9, np.array([0.0539, 0.0399, -0.2643]), 3.26),
    (20.6, np.array([-0.0726, -0.0371, -0.2694]), 5.64),
    (17.7, np.array([0.0056, -0.0088, 0.0018]), 5.47),
    (11.4, np.array([0.0117, -0.0227, -0.0257]), 2.8),
]


@nightly
@pytest.mark.parametrize("swing", SWINGS, ids=lambda swing: f"period of {swing[0]} frames")
def test_errors_of_a_swing_are_as_large_as_stated(swing: tuple[float, Array, float]) -> None:
    """Of weak swings and of strong ones, to which five or three frames are fitted."""
    z = np.sqrt(np.mean(scores(swing, 3, (110, 150)) ** 2, axis=1))
    assert ((z > 0.4) & (z < 1.2)).all(), z


@nightly
def test_growth_of_a_swing_has_no_errors_of_fits_to_more_frames() -> None:
    """Fits to nine and five frames, over which the plane moves by several waves to and fro, explain nothing."""
    recording, _ = oscillating(9.0, np.array([1.0, 0.2, 0.5]), 0.0, 2, (110, 150))
    found = st.estimate(recording, "refined", discontinuity_refit=False).isel(t=0)
    valid = found["status"].values == 2
    assert valid.mean() > 0.3
    z = found["growth_rate"].values[valid] / found["growth_rate_std"].values[valid]
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.2


@nightly
def test_changes_that_noise_hides_are_part_of_the_error_of_an_unsteady_motion() -> None:
    """A component that changes by less than the noise of the shorter span, and by more than that of all frames.

    This noise bounds the error: errors are at most as large as stated, up to the scatter of four recordings.
    """
    square = np.mean([np.mean(scores(WEAK, seed)[0] ** 2) for seed in range(4)])
    assert np.sqrt(square) < 1.1


def test_pixels_at_outlines_have_the_errors_of_their_surface() -> None:
    """Left and right of a gap are two surfaces; pixels in the gap belong to the nearer one in disparity."""
    shape = (8, 30)
    theta = np.zeros((15, *shape))
    theta[0] = np.where(np.arange(30) < 15, 4.0, 8.0)
    whole = (np.arange(30) < 10) | (np.arange(30) >= 20)
    square = np.zeros((16, *shape))
    square[0] = np.where(np.arange(30) < 15, 1.0, 3.0)
    errors = SystematicErrors(square, 2.0 * square, np.tile(whole, (8, 1)), theta)
    fit = blank_fit(theta, variances=True)
    fit.variance[:], fit.element_variance[:] = 0.5, 0.5
    fit.theta[0, :, 10:20] = 8.0
    near = np.zeros(shape, dtype=np.bool_)
    near[4:, 10:20] = True
    stated = errors.added(fit, near).variance[0]
    np.testing.assert_allclose(stated[:4], np.tile(np.where(np.arange(30) < 10, 1.5, 3.5), (4, 1)))
    np.testing.assert_allclose(stated[4:, 10:20], 6.5)


def test_the_second_of_two_cameras_must_see_half_of_the_window() -> None:
    theta = np.zeros((15, 20, 40))
    theta[0] = 12.0
    seen = sees_second_camera(stack(2, np.arange(-1.0, 2.0)), theta, 3.0)
    # Splines need two pixels beyond a sample.
    assert not seen[:, :13].any()
    assert seen[:, 15:].all()
    assert sees_second_camera(stack(3, np.arange(-1.0, 2.0)), theta, 3.0).all()


@pytest.mark.parametrize("seed", [13, *by_night(*(n for n in range(24) if n != 13))])
def test_windows_do_not_leave_the_image_of_the_second_camera(seed: int) -> None:
    """No disparity is explained by pixels of the first camera alone, whose images agree with any disparity."""
    plane = MovingPlane((0.0, 0.0), (0.05, -0.03, -0.4), baseline_mm=12.0, size=(40, 64), seed=seed)
    found = st.estimate(plane.recording(2, 2, noise_std=0.005, seed=seed), "refined").sel(t=0)
    error = (found["disparity"] - plane.truth()["disparity"]) / found["disparity_std"]
    valid = found["valid"].values
    # Five deviations: a chance of one in 1,000 among 1,400 pixels, if they were independent.
    assert np.abs(error.values[valid]).max() < 5.0
    assert valid.mean() > 0.5
    reasons = found["invalid_reason"].attrs["flag_meanings"].split()
    assert (found["invalid_reason"].values[4:-4, :20] == reasons.index("border")).all()


def test_texture_on_one_side_only_is_an_outline_before_a_blank_surface() -> None:
    generator = np.random.default_rng(3)
    texture = 1.0 + generator.uniform(-0.5, 0.5, (60, 80))
    half = np.where(np.arange(80) < 40, texture, 1e-3)
    surrounded = is_surrounded(half, 4.0)
    assert surrounded[:, :36].all()
    assert not surrounded[:, 40:43].any()
    # The inside of printed squares of 16 px is blank.
    printed = np.where((np.arange(80) % 16 < 2) | (np.arange(60)[:, None] % 16 < 2), texture, 1e-3)
    assert is_surrounded(printed, 4.0)[12:-12, 12:-12].all()


def test_neighbours_of_the_same_surface_support_a_pixel() -> None:
    """Both sides of a step are supported up to it, a mixture of both is not, nor are pixels that differ by chance."""
    theta = np.zeros((15, 40, 40))
    theta[0] = np.where(np.arange(40) < 20, 4.0 + 0.1 * np.arange(40), 9.0)
    theta[1] = np.where(np.arange(40) < 20, 0.1, 0.0)
    theta[0, 10, 12], theta[0, :, 20] = 5.5, 7.0
    fit = blank_fit(theta, variances=True)
    fit.variance[:] = 1e-4
    supported = is_supported(fit, np.ones((40, 40), dtype=np.bool_))
    expected = np.ones((40, 40), dtype=np.bool_)
    expected[10, 12], expected[:, 20] = False, False
    np.testing.assert_array_equal(supported[4:-4, 4:-4], expected[4:-4, 4:-4])


def test_fewer_frames_that_contradict_all_frames_have_the_difference_as_their_error() -> None:
    """Of three pixels, the first differs by 0.09 px per frame, the second by 0.11, the third also without residual."""
    theta = np.zeros((15, 1, 3))
    theta[0] = 8.0
    full, fit = blank_fit(theta, variances=True), blank_fit(theta, variances=True)
    full.variance[:], fit.variance[:] = 1e-8, 1e-6
    fit.theta[6, 0] = [0.09 / 8.0, 0.11 / 8.0, 0.11 / 8.0]
    found = add_contradiction(full, fit, np.array([[True, True, False]]), spline_transfer(5))
    np.testing.assert_array_equal(found.variance[[0, 1, 2, 4, 5]], fit.variance[[0, 1, 2, 4, 5]])
    np.testing.assert_array_equal(found.variance[3, 0, [0, 2]], fit.variance[3, 0, [0, 2]])
    # Output divides variances by the square of the splines' transfer.
    added = (found.variance[3, 0, 1] - 1e-6) / spline_transfer(5) ** 2
    assert added == pytest.approx((0.11 / 8.0) ** 2)


def test_noise_does_not_surround_an_edge() -> None:
    """The edge between two blank surfaces has no texture on either side, whatever the gradient of the noise."""
    from scipy.ndimage import gaussian_filter

    generator = np.random.default_rng(2)
    by_noise = 1.0
    # Half the squared sum of two normal derivatives has mean 1; neighbourhoods are means over 1 px.
    noise = gaussian_filter(by_noise * 0.5 * generator.chisquare(2, (80, 80)), 1.0)
    edge = np.zeros((80, 80))
    edge[:, 38:42] = 25.0
    assert is_surrounded(edge + noise, 4.0).mean() > 0.5
    assert not is_surrounded(edge + noise, 4.0, by_noise)[12:-12, 35:45].any()
    # Weak texture on all sides of a pixel.
    assert is_surrounded(4.0 * by_noise + noise, 4.0, by_noise).all()


def test_a_blank_area_between_textures_is_open_if_it_continues() -> None:
    """Between strips 12 px apart, a blank wall is open within 3σ = 18 px of its wide part; a square of it is not."""
    generator = np.random.default_rng(6)
    noise, size = 1.0, (90, 120)
    strips = np.zeros(size, dtype=bool)
    strips[:40, 40:48] = strips[:40, 60:68] = True
    ring = np.zeros(size, dtype=bool)
    ring[20:60, 85:115], ring[34:46, 94:106] = True, False
    own = strips | ring
    grey = np.where(own, 40.0 + generator.normal(0, 15, size), 80.0) + generator.normal(0, noise, size)
    gradient = np.where(own, 100.0, 1.0)
    # The gradient of an outline reaches into the blank area.
    near = np.asarray(ndimage.maximum_filter(own, 5))
    gradient[near & ~own] = 20.0
    found = find_open_blanks(gradient, gradient <= 4.0, grey, noise, 6.0)
    assert found[32:, 49:59].mean() > 0.95
    assert found[:, :30].mean() > 0.95
    assert not found[34:46, 94:106].any()
    assert found[own].mean() < 0.1

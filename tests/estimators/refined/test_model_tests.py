"""Fits of other models at one linearisation are those that iterations with these models find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined import (
    Alternative,
    DefectFilteredFrames,
    ImageStack,
    Linearisation,
    Model,
    RefinedState,
    Splines,
    at_nodes,
    blank_fit,
    enlarged,
    find_far,
    of_nearest_node,
    refine,
)
from tests.helpers.nightly import by_night
from tests.helpers.wavy_plane import MovingPlane, turning

Array = NDArray[np.float64]

SIGMA_PX, STEP, EVERY_VARIANCE = 4.0, 2, 10
# The gradient is not that of rotation and isotropic growth, and the motion is not steady.
SHEAR = 1.2e-3 * np.array([[1.0, 0.75, 0.0], [0.75, -1.0, 0.0], [0.0, 0.0, 0.0]])
PLANE = MovingPlane(
    gradient=SHEAR + turning(1e-3, -1e-3, 2e-3), acceleration_mm=(0.0005, -0.0005, 0.005), size=(60, 96), waves=16
)
SETTINGS = RefinedSettings(window_sigma_px=SIGMA_PX, surface="plane", motion="growing", acceleration=False)
# All cameras and frames see these windows.
INNER = (..., slice(14, -14, STEP), slice(34, -34, STEP))
VARIANCES = (0, 3, 4, 5, 6, 7, 8)
AFFINE, BENT, PLAIN = Model(3, 3, 3), Model(3, 3, 3, True), Model(3, 3, 2)


@pytest.fixture(scope="module")
def images() -> ImageStack:
    recording = PLANE.recording(noise_std=0.001, seed=5)
    splines = Splines(DefectFilteredFrames(recording), 5).frames(0, 9)
    positions = np.stack([recording["s"].values, np.zeros(5)], axis=-1)
    centre = (PLANE.size[1] - 1) / 2, (PLANE.size[0] - 1) / 2
    times = recording["t"].values.astype(float)
    return ImageStack(splines, positions, times, PLANE.focal_px, centre, np.zeros((45, 4)))


def iterated(images: ImageStack, **changed: Any) -> RefinedState:
    return refine(images, PLANE.start(), SETTINGS.model_copy(update=changed))


@pytest.mark.parametrize(
    ("alternative", "changed"),
    [
        ((9, AFFINE, SIGMA_PX), {"motion": "affine"}),
        ((5, BENT, SIGMA_PX), {"motion": "affine", "acceleration": True}),
        ((3, PLAIN, SIGMA_PX), {}),
        *by_night(((9, BENT, SIGMA_PX), {"motion": "affine", "acceleration": True}), ((5, PLAIN, SIGMA_PX), {})),
        ((9, PLAIN, SIGMA_PX / 2), {"window_sigma_px": SIGMA_PX / 2}),
    ],
)
def test_linear_fits_are_those_of_iterations(images: ImageStack, alternative: Any, changed: dict[str, Any]) -> None:
    """In one pass with another alternative; values differ from those of the plain fit by far more."""
    frames, model, sigma = alternative
    plain = iterated(images)
    state = np.where(np.isfinite(plain.fit.theta), plain.fit.theta, 0.0)
    state[0] = np.where(state[0] == 0.0, np.nanmedian(plain.fit.theta[0]), state[0])
    known = np.asarray(np.isfinite(plain.fit.theta).all(axis=0))
    part = images.within((frames - 1) / 2)
    at = Linearisation(images, state, known, np.zeros_like(known), True, STEP)
    alternatives = [Alternative(images, [AFFINE], SIGMA_PX, 6), Alternative(part, [model], sigma, EVERY_VARIANCE)]
    found = at.fits(alternatives)[1]
    inner = slice(7, -7), slice(17, -17)
    full = iterated(part, **changed).fit
    places = [0, 6, 9, 12, *([15, 16, 17] if model.accelerated else [])]
    changes = []
    for number, place in enumerate(places):
        expected = full.theta[place][INNER]
        change = expected - (plain.fit.theta[place][INNER] if place < 15 else 0.0)
        error = found.theta[place][inner] - expected
        std = np.sqrt(full.variance[VARIANCES[number]][INNER])
        assert (
            np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(change**2)) or np.sqrt(np.mean((error / std) ** 2)) < 0.3
        )
        changes.append(np.sqrt(np.mean((change / std) ** 2)))
        # The residual at the present parameters is that of the plain model, which has no acceleration.
        if not model.accelerated:
            assert np.median(found.variance[VARIANCES[number]][inner] / std**2) == pytest.approx(1.1, abs=0.2)
    assert max(changes) > 0.6


def test_steps_are_compared_with_a_tenth_of_a_pixel(images: ImageStack) -> None:
    """In the farthest camera, two steps away, and only of windows with texture."""
    state = np.zeros((15, 4, 6))
    state[0] = 8.0
    fit = blank_fit(state, variances=True)
    fit.residual[0], fit.residual[1] = 1e-6, 1.0
    fit.theta[0, :, 2:] += 0.045
    fit.theta[0, :, 4:] += 0.01
    fit.residual[1, 3] = 0.0
    expected = np.zeros((4, 6), dtype=np.bool_)
    expected[:3, 4:] = True
    np.testing.assert_array_equal(find_far(images, state, fit), expected)


def test_pixels_take_the_nearest_node() -> None:
    """Of images whose size is no multiple of the step, too."""
    places = np.mgrid[:10, :15].astype(np.float64)
    nodes = places[:, ::4, ::4]
    found = enlarged(nodes, 4, (10, 15))
    np.testing.assert_array_equal(found[:, ::4, ::4], nodes)
    # Beyond the last node there is no other.
    assert np.abs(found - places)[:, :, :14].max() == 2.0
    where = places.sum(axis=0) % 3 == 0
    np.testing.assert_array_equal(of_nearest_node(nodes, 4, where), found[:, where])
    assert at_nodes(blank_fit(np.zeros((15, 10, 15)), variances=True), 4).theta.shape == (15, 3, 4)


def test_windows_that_noise_alone_moves_are_not_far(images: ImageStack) -> None:
    """Standard deviations of the displacement in the farthest image follow from those of its parameters."""
    state = PLANE.start()
    theta = np.zeros((15, *images.shape))
    theta[[0, 6, 9, 12]] = state
    fit = blank_fit(theta, variances=True, element=False)
    fit.residual[0], fit.residual[1] = 1e-6, 1.0
    # The farthest frame is 4 away: a velocity error moves a point by 4 d times as much.
    moved_px = np.linspace(0.0, 1.0, images.shape[1])
    fit.theta[6] += moved_px / (4.0 * state[0])
    std_px = 0.15
    fit.variance[:] = 0.0
    fit.variance[3] = (std_px * images.transfer / (4.0 * state[0])) ** 2
    expected = np.broadcast_to(moved_px > np.hypot(0.1, 3.0 * std_px), images.shape)
    np.testing.assert_array_equal(find_far(images, theta, fit, 3.0), expected)
    np.testing.assert_array_equal(find_far(images, theta, fit), np.broadcast_to(moved_px > 0.1, images.shape))

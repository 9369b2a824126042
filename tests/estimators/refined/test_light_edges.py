"""Errors of the motion at borders of shadows that do not move with the surface are stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import FrameDifferences, compare_velocities
from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane

SHAPE = (40, 48)
SIGMA_PX = 3.0
NOISE_STD = 0.003
TIMES = np.repeat([-1.0, 0.0, 1.0], 3)


def differences(tensor: NDArray[np.float64], side: NDArray[np.float64]) -> FrameDifferences:
    """Differences that are known everywhere, without those between and within frames."""
    zero = np.zeros(tensor.shape[1:])
    squares = np.full(tensor.shape[1:], float(np.sum(TIMES**2)))
    return FrameDifferences(zero == 0, zero, zero, tensor, side, squares)


def test_error_of_a_velocity_is_that_against_the_pixels_without_changes() -> None:
    generator = np.random.default_rng(1)
    gradient = generator.normal(size=(2, *SHAPE))
    strip = np.zeros(SHAPE, dtype=bool)
    strip[:, 20:24] = True
    # The fit is wrong in the middle only; grey values change where it is, except where the light does.
    error = np.where(np.abs(np.arange(48) - 22) < 6, 1.0, 0.0) * np.array([0.3, -0.1])[:, None, None]
    velocity = error + np.array([0.5, 0.2])[:, None, None] * np.ones(SHAPE)
    slope = np.where(strip, 7.0, (gradient * error).sum(axis=0))
    tensor = np.stack([gradient[0] ** 2, gradient[0] * gradient[1], gradient[1] ** 2])
    change, noise = compare_velocities(differences(tensor, gradient * slope), strip, velocity, SIGMA_PX, 1e-9)
    # A millionth of the texture is added for stability.
    np.testing.assert_allclose(change, (error * np.ones(SHAPE)) ** 2, rtol=1e-4, atol=1e-12)
    assert noise.max() < 1e-12


def test_fewer_pixels_have_more_noise() -> None:
    # Unit gradients in all directions: the variance is that of a weighted mean, by the share of the weight left.
    tensor = np.stack([np.ones(SHAPE), np.zeros(SHAPE), np.ones(SHAPE)])
    changed = np.zeros(SHAPE, dtype=bool)
    changed[:, 25:] = True
    nothing = np.zeros((2, *SHAPE))
    change, noise = compare_velocities(differences(tensor, nothing), changed, nothing, SIGMA_PX, 0.1)
    assert change.max() < 1e-24
    at = np.arange(-6, 7)
    weights = np.exp(-0.5 * (at / SIGMA_PX) ** 2)
    of_all = 0.1**2 / (np.sum(TIMES**2) * 4 * np.pi * SIGMA_PX**2)
    for column in (10, 20, 24):
        # Pixels next to changed ones are not used.
        share = weights[column + at < 24].sum() / weights.sum()
        np.testing.assert_allclose(noise[:, 20, column], of_all * (1 / share - 1), rtol=1e-4, atol=1e-4 * of_all)


@pytest.mark.parametrize("frames", [2, 3, 5, 9])
def test_changes_differ_from_noise_other_surfaces_and_motion(frames: int) -> None:
    generator = np.random.default_rng(frames)
    between = generator.chisquare(frames - 1, (200, 300)) / (frames - 1)
    within = generator.chisquare(2 * frames, between.shape) / (2 * frames)
    between[:, 50:56], between[:, 150:156] = 12.0, 12.0
    within[:, 150:156] = 12.0
    zero, times = np.zeros((3, *between.shape)), np.full(between.shape, 10.0)
    seen = FrameDifferences(between > 0, between, within, zero, zero[:2], times)
    found = seen.find_changed(frames, 1.0, SIGMA_PX)
    assert found[:, 51:55].all()
    assert not found[:, 140:166].any()
    # Texture that is displaced by 0.01 px per frame, with a gradient of 400 times the noise, changes as much.
    tensor = np.stack([np.full(between.shape, 4e5), zero[0], zero[0]])
    assert not replace(seen, tensor=tensor).find_changed(frames, 1.0, SIGMA_PX).any()
    found[:, 45:61] = False
    assert found.mean() < 1e-4


def shaded(depth: float, seed: int = 0) -> tuple[xr.Dataset, MovingPlane]:
    """A plane that moves under the shadow of a rod at rest, which is the same for all cameras."""
    plane = MovingPlane(size=(56, 72), slopes=(0.0, 0.0), velocity_mm=(0.4, 0.0, 0.0), waves=24)
    x = np.arange(72.0)
    images = np.empty((3, 5, 56, 72))
    disparity = plane.focal_px * plane.baseline_mm / plane.depth_mm
    for i, s in enumerate(centred_indices(3)):
        at = x + disparity * s - 36.0
        left, right = (1.0 / (1.0 + np.exp(-(at + side) / 0.8)) for side in (7.0, -7.0))
        light = 1.0 - depth * (left - right)
        for j, t in enumerate(centred_indices(5)):
            images[i, j] = light * plane.image((plane.baseline_mm * s, 0.0), t)
    images += np.random.default_rng(seed).normal(0.0, NOISE_STD, images.shape)
    return make_recording(images, plane.focal_px, plane.baseline_mm), plane


@nightly
def test_error_by_a_shadow_at_rest_is_stated() -> None:
    recording, plane = shaded(0.7)
    found = st.estimate(recording, "refined").isel(t=0)
    valid = (found["valid"].values == 1) & (np.abs(np.arange(72) - 35.5) < 14)
    assert valid.mean() > 0.1
    error = found["velocity"].values[0] - plane.velocity_mm[0]
    z = np.abs(error / found["velocity_std"].values[0])[valid]
    # Without the comparison, 1.6.
    assert np.sqrt(np.mean(z**2)) < 1.25

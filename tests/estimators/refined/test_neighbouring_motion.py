"""Windows that keep a simpler motion than their surroundings state the difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import neighbouring_differences
from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane, turning

Array = NDArray[np.float64]

SHAPE = (30, 60)
NOISE_STD = 0.003


def parameters() -> Array:
    """A tilted plane with q_X that changes by 0.01 per px along x and by -0.02 along y; q_Y = 1 and q_Z = 2."""
    y, x = np.indices(SHAPE)
    theta = np.zeros((15, *SHAPE))
    theta[0], theta[1], theta[2] = 8.0 + 0.02 * x + 0.01 * y, 0.02, 0.01
    theta[6], theta[7], theta[8] = 0.01 * x - 0.02 * y, 0.01, -0.02
    theta[9], theta[12] = 1.0, 2.0
    return theta


def compared(theta: Array, rank: NDArray[np.intp], std: float = 0.01) -> Array:
    return neighbouring_differences(theta, np.full((3, *SHAPE), std**2), rank, 24, 6.0)


def test_a_strip_over_more_frames_has_its_difference_from_the_surroundings() -> None:
    theta, rank = parameters(), np.full(SHAPE, 2, dtype=np.intp)
    rank[:, 20:24] = 1
    theta[9, :, 20:24] += 0.3
    found = compared(theta, rank)
    assert found[1, :, 20:24] == pytest.approx(0.3**2)
    assert found[[0, 2]] == pytest.approx(0.0, abs=1e-20)
    found[:, :, 20:24] = 0.0
    assert not found.any()


def test_other_surfaces_far_windows_and_steady_surroundings_do_not_count() -> None:
    theta, rank = parameters(), np.zeros(SHAPE, dtype=np.intp)
    rank[:, :10] = 1
    theta[12, :, 10:] += 0.3
    assert np.flatnonzero(compared(theta, rank)[2].any(axis=0)).tolist() == list(range(10, 34))
    theta[0, :, 10:] += 1.0
    assert not compared(theta, rank).any()
    single = np.zeros(SHAPE, dtype=np.intp)
    single[5, 5] = 1
    assert not compared(parameters(), single).any()


def test_noise_of_extrapolated_velocities_does_not_count() -> None:
    """At r px, the standard deviation grows by √(1 + r² / 72), so that 0.3 is one of 0.2 up to r = 9.5."""
    theta, rank = parameters(), np.zeros(SHAPE, dtype=np.intp)
    rank[:, :10] = 1
    theta[12, :, 10:] += 0.3
    assert np.flatnonzero(compared(theta, rank, 0.2)[2].any(axis=0)).tolist() == list(range(10, 19))


# Axis and rate of a turn in rad per frame, its acceleration, velocity in mm per frame, distance of the axis in mm.
TURNS = {
    "about the normal, off the edge": ((-0.18, -0.36, 1.0), 9e-3, 0.0, (-60.0, 30.0)),
    "faster and faster": ((-1.2, 0.8, 2.2), -8e-4, 1e-4, (60.0, 30.0)),
    "in the plane": ((0.8, 0.6, 0.4), 6e-3, 0.0, (0.0, 0.0)),
}


def turned(name: str) -> tuple[MovingPlane, Array]:
    """A plane whose truth is that of the estimated frame, and its images."""
    (axis, rate, acceleration, (x, y)) = TURNS[name]
    plane = MovingPlane(size=(110, 150), slopes=(0.18, 0.36), waves=40, seed=len(name))
    unit = np.array(axis) / np.linalg.norm(axis)
    pivot = np.array([x, y, 0.18 * x + 0.36 * y])
    images = np.empty((3, 9, *plane.size))
    for i, x_mm in enumerate(plane.baseline_mm * centred_indices(3)):
        for j, t in enumerate(centred_indices(9)):
            angle, across = rate * t + 0.5 * acceleration * t**2, turning(*unit)
            gradient = np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
            moved = tuple(-gradient @ pivot)
            images[i, j] = replace(plane, gradient=gradient, velocity_mm=moved).image((x_mm, 0.0), 1.0)
    images += np.random.default_rng(5).normal(0.0, NOISE_STD, images.shape)
    gradient = rate * turning(*unit)
    return replace(plane, gradient=gradient, velocity_mm=tuple(-gradient @ pivot)), images


@nightly
@pytest.mark.parametrize("name", TURNS)
def test_errors_of_turning_planes_are_stated(name: str) -> None:
    """In RMS at most 1.2 standard deviations; the circular motion about a distant axis accelerates."""
    plane, images = turned(name)
    found = st.estimate(make_recording(images, plane.focal_px, plane.baseline_mm), "refined").isel(t=0)
    truth, valid = plane.truth(), found["status"].values == 2
    assert valid.mean() > 0.85
    z = (found["velocity"].transpose("component", "y", "x").values - truth["velocity"])[:, valid]
    z /= found["velocity_std"].transpose("component", "y", "x").values[:, valid]
    assert np.sqrt(np.mean(z**2, axis=1)).max() < 1.2
    assert np.mean(np.abs(z) > 6) < 1e-3

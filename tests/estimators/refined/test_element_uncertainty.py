"""Uncertainty of slopes, rotation and growth due to poses and calibration, against geometry and displaced images."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import CalibrationUncertainty, compute_calibration_effect, compute_pose_effect
from tests.helpers.nightly import nightly
from tests.helpers.shifted_stack import DISPARITY, shifted_parameters, shifted_stack
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
SHAPE, FOCAL = (72, 96), 1000.0
CENTRE = (47.5, 35.5)
SLOPE_X, SLOPE_Y, ROTATION_X, GROWTH = 0, 1, 4, 7
IMAGES = shifted_stack(lambda x, y: 0.2 * np.cos(2 * np.pi * x / 5) + 0.2 * np.cos(2 * np.pi * y / 5))
MIDDLE = (slice(20, -20), slice(24, -24))


def _rooted(by_position: Array) -> Array:
    """Return L of errors of three positions, shape (3, 4), the same at all of three visits and of unknown sign."""
    return np.tile(by_position, (3, 1)).reshape(-1, 1)


@pytest.mark.parametrize(("quantity", "correction", "size"), [(SLOPE_Y, 2, 1e-4), (SLOPE_X, 3, 2e-4)])
def test_rolls_and_scales_tilt_the_surface(quantity: int, correction: int, size: float) -> None:
    """In proportion to s, a roll displaces points by a y s, a disparity that increases along y; a scale along x."""
    by_position = np.zeros((3, 4))
    by_position[:, correction] = size * np.array([-1.0, 0.0, 1.0])
    found = compute_pose_effect(IMAGES, shifted_parameters(), _rooted(by_position), (0.0, 0.0), 6.0)
    np.testing.assert_allclose(np.sqrt(found[quantity][MIDDLE]), FOCAL * size / DISPARITY, rtol=0.03)
    other = SLOPE_X + SLOPE_Y - quantity
    assert np.sqrt(found[other][MIDDLE]).max() < 0.15 * FOCAL * size / DISPARITY


def test_rotations_of_the_camera_bend_the_surface_towards_the_borders() -> None:
    """Two independent yaws α displace by f α x² / f²: a slope of disparity of √2 α x / f."""
    yaw_px = 0.5
    found = compute_pose_effect(IMAGES, shifted_parameters(), np.zeros((36, 1)), (yaw_px, 0.0), 6.0)
    # Variances are means over adjacent points, up to 24 px apart.
    x, apart_px = np.arange(SHAPE[1]) - CENTRE[0], 24.0
    least, most = (np.sqrt(2.0 * (x**2 + add)) * yaw_px / FOCAL / DISPARITY for add in (0.0, apart_px**2))
    stated = np.sqrt(found[SLOPE_X][SHAPE[0] // 2])
    assert (stated > 0.98 * least)[24:-24].all()
    assert (stated < 1.02 * most)[24:-24].all()


def test_displacements_in_proportion_to_time_are_a_motion() -> None:
    """A common motion neither tilts, turns nor enlarges a surface that is parallel to the image."""
    by_visit = np.zeros((3, 3, 4))
    by_visit[..., 0] = 0.1 * np.array([-1.0, 0.0, 1.0])[:, None]
    found = compute_pose_effect(IMAGES, shifted_parameters(), by_visit.reshape(-1, 1), (0.0, 0.0), 6.0)
    assert np.sqrt(found[[SLOPE_X, SLOPE_Y, ROTATION_X, GROWTH]][:, *MIDDLE]).max() < 1e-6


def _tilted_parameters() -> Array:
    """Return the parameters of a tilted plane that moves, turns and grows along one direction."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    x, y = x - CENTRE[0], y - CENTRE[1]
    theta = np.zeros((15, *SHAPE))
    theta[1], theta[2] = 0.004, -0.003
    theta[0] = 12.0 + theta[1] * x + theta[2] * y
    gradient = np.array([[0.3, -0.2], [0.1, 0.4], [0.5, -0.6]]) * 1e-4
    for k, (first, (along, down)) in enumerate(zip((0.05, -0.03, 0.08), gradient, strict=True)):
        theta[6 + 3 * k] = first + along * x + down * y
        theta[7 + 3 * k], theta[8 + 3 * k] = along, down
    return theta


def _seen(theta: Array, at: tuple[int, int], show: Callable[[Array], Array], focal: float, centre: Array) -> Array:
    """Return slopes and growth of a surface element from where images show three of its points, without derivatives.

    ``show``: Position in the image of a position of the pinhole. ``focal``, ``centre``: Intrinsics of the analysis.
    """
    row, column = at
    start, step, apart, frames = theta[:, row, column], 0.01, 1e-3, 1e-3
    places = np.array([[0.0, 0.0], [step, 0.0], [0.0, step]])
    d = start[0] + places @ start[1:3]
    q = np.stack([start[6 + 3 * k] + places @ start[7 + 3 * k : 9 + 3 * k] for k in range(3)], axis=-1)
    xy = places + [column - CENTRE[0], row - CENTRE[1]]
    points = np.column_stack([xy, np.full(3, FOCAL)]) / d[:, None]
    areas, slopes = [], np.zeros(2)
    for t in (-frames, 0.0, frames):
        now = points + t * q
        seen = [show(FOCAL * (now[:, :2] - [s, 0.0]) / now[:, 2:]) - centre for s in (-apart, 0.0, apart)]
        disparity = (seen[0] - seen[2])[:, 0] / (2.0 * apart)
        element = np.column_stack([seen[1], np.full(3, focal)]) / disparity[:, None]
        normal = np.cross(element[1] - element[0], element[2] - element[0])
        areas.append(np.linalg.norm(normal))
        if t == 0.0:
            slopes = -normal[:2] / normal[2]
    return np.array([*slopes, (areas[2] - areas[0]) / (2.0 * frames * areas[1])])


def _distorted(places: Array) -> Array:
    """Return positions displaced by a smooth field of about a hundredth of a pixel."""
    x, y = places[..., 0], places[..., 1]
    moved = [1e-8 * x * (3 * x**2 + y**2) + 3e-7 * y**2 * x, 2e-7 * y**3 - 1e-7 * x**2 * y]
    return np.asarray(places + np.stack(moved, axis=-1))


@pytest.mark.parametrize(
    ("given", "show", "focal", "centre"),
    [
        ({"focal": 1e-4}, np.array, 1.0001 * FOCAL, (0.0, 0.0)),
        ({"centre": (2e-4, 0.0)}, np.array, FOCAL, (2e-4 * FOCAL, 0.0)),
        ({"centre": (0.0, 3e-4)}, np.array, FOCAL, (0.0, 3e-4 * FOCAL)),
        ({"displacements": True}, _distorted, FOCAL, (0.0, 0.0)),
    ],
)
def test_errors_of_calibration_against_images_of_a_moving_element(
    given: dict[str, Any], show: Callable[[Array], Array], focal: float, centre: tuple[float, float]
) -> None:
    theta = _tilted_parameters()
    if "displacements" in given:
        y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
        places = np.stack([x - CENTRE[0], y - CENTRE[1]], axis=-1)
        uncertainty = CalibrationUncertainty(displacements=np.moveaxis(_distorted(places) - places, -1, 0)[None])
    else:
        uncertainty = CalibrationUncertainty(**given)
    found = np.sqrt(compute_calibration_effect(IMAGES, theta, uncertainty)[[SLOPE_X, SLOPE_Y, GROWTH]])
    for row, column in ((20, 30), (36, 48), (60, 80)):
        # An error of the lens displaces an element to another pixel; its shape there is that of the element.
        before = _seen(theta, (row, column), np.array, FOCAL, np.zeros(2))
        change = np.abs(_seen(theta, (row, column), show, focal, np.array(centre)) - before)
        np.testing.assert_allclose(found[:, row, column], change, rtol=0.02, atol=2e-3 * change.max())


@nightly
def test_stated_slopes_hold_where_poses_are_not_stated() -> None:
    """Unstated shifts and rolls tilt windows through their oblique gradients: mean of two draws."""
    within, stds = [], []
    for seed in (1, 3):
        generator = np.random.default_rng(seed)
        plane = MovingPlane(size=(80, 112), seed=seed)
        off = np.repeat(generator.normal(0, 1, (5, 1, 4)) * [0.06, 0.06, 3e-4, 1e-5], 3, axis=1)
        recording = plane.recording(5, 3, noise_std=0.002, moved=off - off[2, 1])
        settings = {"window_sigma_px": 4.0, "window_frames": 3, "discontinuity_refit": False}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found, trusted = (
                st.estimate(recording, "refined", settings, pose_corrections=each).sel(t=0) for each in ("auto", "none")
            )
        for estimate in (found, trusted):
            error = estimate["slope"].values - plane.truth()["slope"]
            inner = (error / estimate["slope_std"].values)[:, 16:-16, 20:-20]
            within.append(float(np.mean(np.abs(inner[np.isfinite(inner)]) < 2)))
            stds.append(float(np.nanmedian(estimate["slope_std"].values)))
    assert np.mean(within[::2]) > 0.95
    # Otherwise, the residuals of the frames alone enlarge the deviations.
    assert np.mean(within[::2]) > np.mean(within[1::2]) + 0.02
    assert (np.array(stds[::2]) > stds[1::2]).all()

"""Lens distortion against OpenCV, its own inverse, finite differences, and images that fold."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from scenetruth.camera import Camera, Distortion

LENS = Distortion(k1=-0.21, k2=0.07, p1=1e-3, p2=-7e-4, k3=-0.01, k4=0.02, k5=-0.003, k6=1e-4)
INTRINSICS = {"width": 640, "height": 480, "focal_length_px": 700.0}


def matrix(camera: Camera) -> np.ndarray:
    return np.array(
        [[camera.focal_px, 0, camera.principal_point[0]], [0, camera.focal_px, camera.principal_point[1]], [0, 0, 1.0]]
    )


def test_projects_as_opencv() -> None:
    camera = Camera(**INTRINSICS, distortion=LENS)
    points = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 700], (200, 3))
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(camera), np.array(LENS.coefficients))
    # Both compute in double precision: some roundings of 600 px.
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-10)


def test_opencv_undistorts_what_we_distort() -> None:
    camera = Camera(**INTRINSICS, distortion=LENS)
    points = np.random.default_rng(1).uniform([-200, -150, 500], [200, 150, 700], (500, 3))
    straight = camera.without_distortion().project(points)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    undistort = getattr(cv2, "undistortPointsIter", None)
    arguments = (camera.project(points), matrix(camera), np.array(LENS.coefficients))
    if undistort is not None:  # OpenCV 4, whose other function takes five steps only
        back = undistort(*arguments, None, matrix(camera), criteria)
    else:
        back = cv2.undistortPoints(*arguments, P=matrix(camera), criteria=criteria)
    assert np.abs(back[:, 0] - straight).max() < 1e-6
    # Rays that we undistort ourselves meet the same points.
    ours = camera.without_distortion().project(camera.ray_directions(camera.project(points)))
    assert np.abs(ours - straight).max() < 1e-9


@given(
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-3e-3, 3e-3), st.floats(-3e-3, 3e-3)),
    st.floats(-0.4, 0.4),
    st.floats(-0.3, 0.3),
)
@settings(deadline=None)
def test_undistort_inverts_and_slopes_are_derivatives(k: tuple[float, ...], x: float, y: float) -> None:
    lens = Distortion(k1=k[0], k2=k[1], p1=k[2], p2=k[3])
    point = np.array([x, y])
    np.testing.assert_allclose(lens.undistort(lens.distort(point)), point, atol=1e-12)
    h = 1e-6
    for axis in range(2):
        step = h * np.eye(2)[axis]
        difference = (lens.distort(point + step) - lens.distort(point - step)) / (2 * h)
        # Central differences: h² times third derivatives, and rounding over h.
        np.testing.assert_allclose(lens.jacobian(point)[:, axis], difference, atol=1e-9)


def test_steps_are_the_derivatives_of_directions() -> None:
    camera = Camera(**INTRINSICS, distortion=LENS)
    pixels = np.random.default_rng(2).uniform([0, 0], [639, 479], (50, 2))
    h = 1e-3
    for steps, axis in zip(camera.ray_steps(pixels), (0, 1), strict=True):
        aside = h * np.eye(2)[axis]
        difference = (camera.ray_directions(pixels + aside) - camera.ray_directions(pixels - aside)) / (2 * h)
        np.testing.assert_allclose(steps, difference, atol=1e-12)


def test_refined_and_cut_cameras_see_the_same_rays() -> None:
    camera = Camera(**INTRINSICS, principal_point_px=(300.25, 250.5), distortion=LENS)
    fine, rows = camera.refined(4, 7), camera.rows(100, 103)
    pixel = np.array([123.0, 101.0])
    np.testing.assert_allclose(rows.ray_directions(pixel - [0, 100]), camera.ray_directions(pixel), atol=1e-15)
    np.testing.assert_allclose(
        fine.ray_directions((pixel + 7 + 0.5) * 4 - 0.5), camera.ray_directions(pixel), atol=1e-14
    )


@pytest.mark.parametrize("lens", [{"k1": -0.9}, {"k1": 0.5, "k2": -5.0}, {"p1": 1.5}, {"k4": -4.0}])
def test_a_distortion_that_folds_the_image_is_refused(lens: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=r"distortion is not invertible at pixel .* use smaller coefficients"):
        Camera(width=640, height=480, focal_length_px=400, distortion=lens)


def test_strong_but_single_valued_distortion_is_taken() -> None:
    # A barrel turns over where 1 + 3 k1 r² = 0: r = 1.29 before distortion, 0.86 behind it.
    Camera(width=640, height=480, focal_length_px=480, distortion={"k1": -0.2})
    with pytest.raises(ValidationError):
        Camera(width=640, height=480, focal_length_px=460, distortion={"k1": -0.2})

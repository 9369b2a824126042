"""Accuracy and stated covariance of refined corners and dots, on rendered boards."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import Camera, Distortion
from scenetruth.capture.calibration import (
    CharucoBoard,
    DotGrid,
    RefinedPoints,
    detect_board,
    disc_bias,
    estimate_gain_spread,
    estimate_noise,
    refine_points,
    rotation_matrix,
)
from tests.helpers.nightly import by_night, nightly
from tests.helpers.rendered_boards import noisy, render_board, rendered_noise_variance

pytest.importorskip("cv2")

LENS = Distortion(k1=-0.6, k2=8, p1=1e-3, p2=-8e-4)
CAMERA = Camera(width=400, height=320, focal_length_px=5016, principal_point_px=(204.0, 155.0), distortion=LENS)
CHARUCO = CharucoBoard(kind="charuco", squares=(9, 6), square_mm=5.6, marker_mm=4.2)
DOTS = DotGrid(kind="dots", dots=(7, 5), spacing_mm=7.0, diameter_mm=3.0)
PLACE = np.array([0.5, -0.5, 660.0])
TURNS = [np.array([0.5, 0.35, 0.2]), np.array([-0.6, 0.2, -0.3]), np.array([0.1, 0.05, 0.7])]

Array = NDArray[np.float64]


def refined(
    board: CharucoBoard | DotGrid, turn: Array, seed: int | None, blur_px: float = 0.6
) -> tuple[Array, RefinedPoints]:
    """Return the errors of the refined points of a rendered board, and the points."""
    rotation = rotation_matrix(turn)
    clean = render_board(board, CAMERA, rotation, PLACE, blur_px=blur_px)
    image = clean if seed is None else noisy(clean, seed)
    points = refine_points(image, rendered_noise_variance(clean), board, detect_board(image, board))
    true = CAMERA.project(board.points_mm[points.ids] @ rotation.T + PLACE)
    if isinstance(board, DotGrid):
        true = true + disc_bias(CAMERA, rotation, PLACE, board.points_mm[points.ids], board.diameter_mm / 2)
    return points.pixels - true, points


def in_deviations(errors: Array, points: RefinedPoints) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.inv(np.linalg.cholesky(points.covariance_px2)), errors))


@pytest.mark.parametrize("turn", [TURNS[0], *by_night(*TURNS[1:])], ids=["tilted", "other tilt", "turned"])
def test_corners_without_noise(turn: Array) -> None:
    """Half of them to 0.0005 px; where an edge runs along the pixels, samples 1 / 64 px apart displace it."""
    errors, points = refined(CHARUCO, turn, None)
    assert len(points.ids) > 30
    assert np.median(np.abs(errors)) < 0.0005
    assert np.sqrt((errors**2).mean()) < 0.0015
    assert abs(points.blur_px - 0.6) < 0.03


@nightly
def test_stated_covariance_of_corners_is_that_of_their_errors() -> None:
    """240 errors: the standard deviation of z is certain to 5 %, and the limits are four times that."""
    z = []
    for seed, turn in enumerate(TURNS):
        errors, points = refined(CHARUCO, turn, seed)
        assert np.sqrt((errors**2).mean()) < 0.010
        assert 0.9 < points.mean_square < 1.6
        z.append(in_deviations(errors, points))
    found = np.concatenate(z)
    assert len(found) >= 100
    assert 0.8 < np.sqrt((found**2).mean()) < 1.2


@pytest.mark.parametrize("blur_px", [0.0, *by_night(0.2)])
def test_edges_sharper_than_a_pixel(blur_px: float) -> None:
    """The residuals are those of the noise; two points per pixel and axis leave a mean square above 5 without blur."""
    errors, points = refined(CHARUCO, TURNS[0], 5, blur_px)
    assert points.rejected <= 1
    assert points.mean_square < 1.5
    assert 0.6 < np.sqrt((in_deviations(errors, points) ** 2).mean()) < 1.3
    assert abs(points.blur_px - blur_px) < 0.06


def test_markers_of_small_squares_are_kept_out() -> None:
    """Squares of 16 to 21 px, markers 2 px from the edges: residuals of the noise alone, and the true blur.

    The standard deviation of z of 64 values is certain to 9 %; the limits are four times that.
    """
    small = CharucoBoard(kind="charuco", squares=(9, 6), square_mm=2.8, marker_mm=2.1)
    errors, points = refined(small, TURNS[0], 4)
    assert len(points.ids) > 30
    assert points.mean_square < 1.5
    assert abs(points.blur_px - 0.6) < 0.02
    assert 0.64 < np.sqrt((in_deviations(errors, points) ** 2).mean()) < 1.36


@pytest.mark.parametrize("blur_px", [0.4, 1.2])
def test_corners_of_other_blurs(blur_px: float) -> None:
    errors, points = refined(CHARUCO, TURNS[0], 5, blur_px)
    # Markers nearer than three standard deviations of the blur raise the residuals, and with them what is stated.
    assert 0.6 < np.sqrt((in_deviations(errors, points) ** 2).mean()) < 1.3
    assert abs(points.blur_px - blur_px) < 0.06


@nightly
def test_dots_and_their_perspective_bias() -> None:
    errors, points = refined(DOTS, TURNS[0], None)
    assert np.sqrt((errors**2).mean()) < 0.002
    bias = disc_bias(CAMERA, rotation_matrix(TURNS[0]), PLACE, DOTS.points_mm, 1.5)
    assert np.abs(bias).max() > 0.003
    errors, points = refined(DOTS, TURNS[0], 3)
    assert len(points.ids) >= 30
    assert 0.7 < np.sqrt((in_deviations(errors, points) ** 2).mean()) < 1.3


@nightly
def test_dots_of_an_inverted_image_have_the_same_places() -> None:
    """Ground and dots have slopes of their own: under uneven light, dots of full scale are no brighter on one side."""
    clean = render_board(DOTS, CAMERA, rotation_matrix(TURNS[0]), PLACE)
    light = 1 - 0.3 * np.hypot(*(np.mgrid[: CAMERA.height, : CAMERA.width] - 100.0 + 0.5)) / 400
    image = light * (clean - clean.min())
    noise = rendered_noise_variance(clean)
    black = refine_points(image, noise, DOTS, detect_board(image, DOTS))
    bright = DOTS.model_copy(update={"dark": False})
    white = refine_points(3000 - image, noise, bright, detect_board(3000 - image, bright))
    np.testing.assert_array_equal(white.ids, black.ids)
    # The model is the same for both: the places agree to the end of the iteration, 0.01 of the uncertainty.
    assert np.abs(white.pixels - black.pixels).max() < 0.02 * np.sqrt(black.covariance_px2[:, 0, 0].max())


def test_disc_bias_is_that_of_the_ellipse() -> None:
    """The image of a circle is an ellipse, whose centre follows from its conic: an independent closed form."""
    camera = Camera(width=400, height=320, focal_length_px=800, principal_point_px=(200, 160))
    rotation, place, radius = rotation_matrix(np.array([0.6, 0.3, 0.0])), np.array([3.0, -2.0, 100.0]), 2.0
    centre = np.array([[1.0, 2.0, 0.0]])
    to_image = np.array([[800, 0, 200], [0, 800, 160], [0, 0, 1.0]]) @ np.column_stack([rotation[:, :2], place])
    x, y = centre[0, :2]
    circle = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - radius**2]])
    inverse = np.linalg.inv(to_image)
    conic = inverse.T @ circle @ inverse
    ellipse = -np.linalg.solve(conic[:2, :2], conic[:2, 2])
    exact = ellipse - camera.project(centre @ rotation.T + place)[0]
    found = disc_bias(camera, rotation, place, centre, radius)[0]
    # Gauss's rule of degree 5 leaves terms of (radius / distance)^6.
    np.testing.assert_allclose(found, exact, atol=1e-6)
    assert np.abs(exact).max() > 0.05


def test_dirt_on_a_corner_is_rejected_or_stated() -> None:
    rotation = rotation_matrix(TURNS[0])
    clean = render_board(CHARUCO, CAMERA, rotation, PLACE)
    image = noisy(clean, 1)
    detection = detect_board(image, CHARUCO)
    x, y = np.rint(detection.pixels[10]).astype(int)
    image[y - 1 : y + 5, x + 1 : x + 7] = 3500
    points = refine_points(image, rendered_noise_variance(clean), CHARUCO, detection)
    at = np.flatnonzero(points.ids == detection.ids[10])
    assert points.rejected == 1 or points.covariance_px2[at[0], 0, 0] > 4 * np.median(points.covariance_px2[:, 0, 0])


def test_noise_is_estimated_from_one_image() -> None:
    generator = np.random.default_rng(2)
    image = 100 + np.add.outer(np.arange(200) * 0.3, np.arange(240) * 0.2) + 3 * generator.standard_normal((200, 240))
    # The median of 47,000 correlated values is certain to 1 %.
    assert abs(estimate_noise(image) - 3) < 0.1


@pytest.mark.parametrize("spread", [0.0, 0.005, 0.01])
def test_gains_of_pixels_are_measured_on_a_board(spread: float) -> None:
    """Light of 3000 DN has a noise of 0.8 %, to which the gains add: a median of 5000 pixels knows the sum to 3 %."""
    light = np.maximum(render_board(CHARUCO, CAMERA, rotation_matrix(TURNS[0]), PLACE), 1.0)
    draw = np.random.default_rng(8)
    image = light * (1 + spread * draw.standard_normal(light.shape))
    image += np.sqrt(0.2 * light + 4.0) * draw.standard_normal(light.shape)
    found = estimate_gain_spread(image, 0.2 * np.maximum(image, 0.0) + 4.0)
    assert abs(found**2 - spread**2) < 3 * 0.03 * (0.2 / 3000 + spread**2)


def test_gains_of_pixels_need_smooth_parts() -> None:
    image = np.random.default_rng(2).uniform(0, 1000, (100, 120))
    assert estimate_gain_spread(image, np.full(image.shape, 4.0)) == 0

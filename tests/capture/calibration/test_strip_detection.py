"""Dots of a fiducial strip among other objects, at all positions of a stage."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.capture.calibration import BoardImage, CalibrationError, observe_strip
from scenetruth.errors import EstimateWarning
from tests.helpers.nightly import nightly

pytest.importorskip("cv2")

Array = NDArray[np.float64]
X_MM = np.array([-5.0, 0.0, 5.0])
POINTS = np.array([[u, v, 0.0] for v in (-19.0, 19.0) for u in np.linspace(-20, 20, 11)])
PER_MM, NOISE = 6.0, 8.0
SIZE = (280, 400)


def centres(position: int, shift_px: float = 0.0) -> Array:
    """Pixels of the dots: a camera that moves to the right sees them move to the left."""
    turn = 0.02
    flat = POINTS[:, :2] - [X_MM[position], 0.0]
    return np.asarray(PER_MM * flat @ np.array([[1, turn], [-turn, 1]]) + [201.3 + shift_px, 138.6])


@cache
def spots_and_plates(position: int) -> tuple[Array, Array]:
    """Two bright plates with random grey spots between them, and noise, which are the same for all dots."""
    generator = np.random.default_rng(position)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    image = np.full(SIZE, 500.0)
    for _ in range(60):
        spot = generator.uniform([0, 50], [SIZE[1], SIZE[0] - 50])
        away = np.hypot(x - spot[0], y - spot[1])
        image -= generator.uniform(100, 400) * np.clip(generator.uniform(3, 9) - away, 0, 1)
    rows = np.abs(np.abs(y - 138.6) - 19 * PER_MM) < 14
    image[rows] = 2000
    return image, NOISE * generator.standard_normal(SIZE)


@cache
def image_of(position: int, hidden: int = 0, shift_px: float = 0.0) -> Array:
    """Dark dots on two bright plates, and random grey spots between them; edges blurred by a pixel."""
    plates, noise = spots_and_plates(position)
    image, (y, x) = plates.copy(), np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    rows = np.abs(np.abs(y - 138.6) - 19 * PER_MM) < 14
    for dot in centres(position, shift_px)[hidden:]:
        # Mean over the pixel of a blurred edge, in a closed form that is symmetric about the dot.
        image -= np.where(rows, 1700.0, 0.0) * 0.5 * (1 - np.tanh((np.hypot(x - dot[0], y - dot[1]) - 5) / 0.8))
    image += noise
    image.setflags(write=False)
    return image


def recorded(hidden: int = 0) -> list[BoardImage]:
    return [
        BoardImage(image_of(s, hidden), s, 50, visit=20 + s, name=f"s{s}", variance=NOISE**2) for s in range(len(X_MM))
    ]


def test_all_dots_with_their_errors() -> None:
    views = observe_strip(recorded(), POINTS, X_MM, target=1)
    z = []
    for view, position in zip(views, range(3), strict=True):
        assert (view.position, view.visit, view.pose, view.target) == (position, 20 + position, 50, 1)
        assert len(view.pixels) == len(POINTS)
        np.testing.assert_array_equal(view.points_mm, POINTS)
        errors = view.pixels - centres(position)
        assert np.abs(errors).max() < 0.03
        z.append(np.einsum("nij,nj->ni", np.linalg.inv(np.linalg.cholesky(view.covariance_px2)), errors))
    # Edges of another form than assumed: stated too large rather than too small.
    assert 0.5 < np.sqrt((np.concatenate(z) ** 2).mean()) < 1.25


@nightly
def test_dots_that_are_hidden_are_omitted() -> None:
    views = observe_strip(recorded(hidden=3), POINTS, X_MM)
    for view in views:
        np.testing.assert_array_equal(view.points_mm, POINTS[3:])


def test_a_turn_by_more_than_half_a_dot_does_not_shift_the_row() -> None:
    """The yaw of a displaced camera moves the image by any part of the 24 px between dots."""
    for shift_px in (-22.0, 14.0, 24.0):
        images = [BoardImage(image_of(0), 0, 50, variance=NOISE**2)]
        images.append(BoardImage(image_of(1, shift_px=shift_px), 1, 50, variance=NOISE**2))
        _, view = observe_strip(images, POINTS, X_MM)
        assert len(view.pixels) == len(POINTS)
        assert np.abs(view.pixels - centres(1, shift_px)).max() < 0.03


@pytest.mark.parametrize("count", [3, 4, 5])
def test_rows_of_few_dots(count: int) -> None:
    """Such rows have fewer dots than a match needs: the second row is found from the first."""
    columns = np.linspace(-20, 20, 11)[:count] + 8
    points = np.array([[u, v, 0.0] for v in (-19.0, 19.0) for u in columns])
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    for position in range(3):
        image = image_of(position, hidden=len(POINTS)).copy()
        turn = np.array([[1, 0.02], [-0.02, 1]])
        places = PER_MM * (points[:, :2] - [X_MM[position], 0.0]) @ turn + [201.3, 138.6]
        for dot in places:
            image -= 1700 * 0.5 * (1 - np.tanh((np.hypot(x - dot[0], y - dot[1]) - 5) / 0.8))
        (view,) = observe_strip([BoardImage(image, position, 50, visit=1, variance=NOISE**2)], points, X_MM)
        np.testing.assert_array_equal(view.points_mm, points)
        assert np.abs(view.pixels - places).max() < 0.03


@nightly
def test_spots_of_a_texture_are_no_strip() -> None:
    """Of ten dots, six spots that lie near expected places by chance would be enough."""
    points = np.array([[u, v, 0.0] for v in (-19.0, 19.0) for u in (-10, -5, 0, 5, 10)])
    y, x = np.mgrid[:240, :320].astype(float)
    for seed in (8, 12):
        generator = np.random.default_rng(seed)
        image = np.full((240, 320), 1800.0)
        for _ in range(250):
            spot, depth = generator.uniform([0, 0], [320, 240]), generator.uniform(200, 500)
            image -= depth * np.clip(generator.uniform(4, 7) - np.hypot(x - spot[0], y - spot[1]), 0, 1)
        image += NOISE * generator.standard_normal(image.shape)
        with pytest.raises(CalibrationError, match="dots of the strip"):
            observe_strip([BoardImage(image, 0, 50, visit=1, variance=NOISE**2)], points, [0.0])


def test_images_without_the_strip_are_named() -> None:
    images = [*recorded(), *recorded(), BoardImage(np.full(SIZE, 500.0), 0, 50, name="dark.tif")]
    with pytest.warns(EstimateWarning, match=r"dark\.tif.*60%"):
        assert len(observe_strip(images, POINTS, X_MM)) == 6
    with pytest.raises(CalibrationError, match=r"dark\.tif"):
        observe_strip(images[-1:], POINTS, X_MM)


def test_points_and_poses_are_checked() -> None:
    with pytest.raises(CalibrationError, match="at least 6 points"):
        observe_strip(recorded(), POINTS[:3], X_MM)
    with pytest.raises(CalibrationError, match="plane"):
        observe_strip(recorded(), POINTS + np.outer(np.arange(len(POINTS)), [0, 0, 1.0]), X_MM)
    moved = [BoardImage(np.zeros(SIZE), 0, pose) for pose in (1, 2)]
    with pytest.raises(CalibrationError, match="does not move"):
        observe_strip(moved, POINTS, X_MM)

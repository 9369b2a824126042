"""Lens distortion beyond the outermost points: lenses seen in the middle of the image only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.capture.calibration import (
    CalibrationError,
    CalibrationTarget,
    DotGrid,
    Observations,
    RigCalibration,
    RigPriors,
    TargetView,
    calibrate,
    rotation_matrix,
)
from tests.helpers.drawn_rigs import board_points, draw_rig
from tests.helpers.nightly import by_night

Array = NDArray[np.float64]
SIZE, FOCAL, CENTRE = (1280, 720), 640.0, (650.0, 352.0)
RATIO: dict[str, Callable[[Array], Array]] = {
    # Radius in the image over that without distortion: a webcam by its published coefficients, an equidistant wide lens
    # and a stereographic one, none of which is a polynomial of two terms.
    "webcam": lambda r: 1 + 0.18 * r**2 - 0.256 * r**4 + 0.124 * r**6,
    "equidistant": lambda r: np.arctan(r) / r,
    "stereographic": lambda r: 2 * np.tan(np.arctan(r) / 2) / r,
}


def pixels_of(points: Array, lens: str) -> Array:
    """Return the image of points in the frame of the camera, shape (n, 2)."""
    rays = points[:, :2] / points[:, 2:]
    radius = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-9)
    return np.asarray(FOCAL * rays * RATIO[lens](radius)[:, None] + CENTRE)


def seen_in_the_middle(lens: str, seed: int, reach_px: float = 320.0) -> Observations:
    """Corners of a board in twelve poses within a distance from the principal point, with noise of 0.05 px."""
    generator, grid, views = np.random.default_rng(seed), board_points(7, 5, 12.0), []
    for pose in range(12):
        about, tilt = 0.5 * pose, 0.6 if pose % 4 else 0.1
        turn = rotation_matrix(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        place = np.array([60 * np.cos(2.1 * pose), 35 * np.sin(2.1 * pose), 200 + 3 * pose])
        pixels = pixels_of(grid @ turn.T + place, lens)
        kept = np.hypot(*(pixels - CENTRE).T) < reach_px
        noisy = pixels + 0.05 * generator.standard_normal(pixels.shape)
        covariance = np.tile(0.0025 * np.eye(2), (int(kept.sum()), 1, 1))
        views.append(TargetView(f"p{pose}", 0, pose, pose, grid[kept], noisy[kept], covariance))
    target = CalibrationTarget(half_width_mm=36.0, scale_std=1e-3, warp_mm=0.0)
    return Observations(*SIZE, np.zeros(1), (target,), tuple(views), 0)


def radial_errors(found: RigCalibration, lens: str, radii: Array) -> tuple[Array, Array]:
    """Return the error of the radius in the image of rays, in px, and its stated standard deviation."""
    powers = radii[:, None] ** np.array([1, 3, 5, 7])
    names = ("f", "k1", "k2", "k3")
    focal, *coefficients = (found.value(name) for name in names)
    slopes = np.column_stack([powers @ [1, *coefficients], focal * powers[:, 1:]])
    rows = [found.names.index(name) for name in names]
    covariance = slopes @ found.covariance[np.ix_(rows, rows)] @ slopes.T
    return focal * powers @ [1, *coefficients] - FOCAL * radii * RATIO[lens](radii), np.sqrt(np.diag(covariance))


@pytest.mark.parametrize("lens", [*list(RATIO)[:1], *by_night(*list(RATIO)[1:])])
def test_lenses_seen_in_the_middle_have_wide_bars_in_the_corners(lens: str) -> None:
    """The camera has no fold; inside the points it is precise, and in the corners off by no more than stated."""
    found = calibrate(seen_in_the_middle(lens, 1))
    assert not found.camera.folding_problem(0)
    assert [text for text in found.warnings if "show boards in the corners of the image" in text]
    assert abs(found.value("f") - FOCAL) < 4 * found.std("f") < 8
    corner = float(np.hypot(*found.camera.ray_directions(np.array([[0.0, 719.0]]))[0, :2]))
    error, stated = radial_errors(found, lens, np.array([0.3, corner]))
    assert stated[0] < 0.5
    assert stated[1] > 10
    assert (np.abs(error) < 4 * stated).all()


def test_a_lens_of_stated_terms_is_not_continued() -> None:
    """Coefficients that a user names are fitted as they are; a fold is an error with its remedy."""
    given = seen_in_the_middle("webcam", 2)
    stated = RigPriors(free_distortion=("k1", "k2"))
    with pytest.raises(CalibrationError, match=r"folds the image.*show boards in the corners"):
        calibrate(given, priors=stated)


def test_dots_in_the_middle_of_the_image_are_calibrated() -> None:
    """The perspective bias of dots needs no camera without a fold in the corners."""
    board = DotGrid(kind="dots", dots=(7, 5), spacing_mm=12.0, diameter_mm=4.0, warp_mm=0.0)
    found = calibrate(seen_in_the_middle("webcam", 1), board)
    assert not found.camera.folding_problem(0)
    assert found.value("f") == pytest.approx(FOCAL, rel=0.01)


def test_boards_over_the_whole_image_need_no_continuation() -> None:
    found = calibrate(draw_rig(3, poses=5, positions=3).observations, guess=5040.0)
    assert found.std("k3") == 0
    assert not [text for text in found.warnings if "outermost points" in text]

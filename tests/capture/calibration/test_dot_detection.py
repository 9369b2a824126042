"""Grids of dots with three hollow dots: partly visible, on dark and bright ground, and input that does not fit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.camera import Camera, Viewpoint
from scenetruth.capture import BoardLight, BoardPrint, BoardRenderer, PlacedBoard, draw_board
from scenetruth.capture.calibration import DotGrid, detect_board, disc_bias, refine_points, rotation_matrix
from tests.helpers.nightly import by_night
from tests.helpers.rendered_boards import noisy, render_board, rendered_noise_variance

pytest.importorskip("cv2")

CAMERA = Camera(width=400, height=320, focal_length_px=4000)
GRID = DotGrid(kind="dots", dots=(10, 8), spacing_mm=5.0, diameter_mm=2.4, markers=((2, 5), (7, 5), (2, 2)))
TURN = rotation_matrix(np.array([0.3, -0.2, 0.25]))

Array = NDArray[np.float64]


def with_holes(board: DotGrid, place: Array, *, fine: int = 16) -> Array:
    """The image of a board whose markers have holes of a third of their diameter."""
    image = render_board(board, CAMERA, TURN, place, fine=fine)
    ground = image.max() if board.dark else image.min()
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width]
    assert board.markers is not None
    for column, row in board.markers:
        centre = CAMERA.project((board.points_mm[row * board.dots[0] + column] @ TURN.T + place)[None])[0]
        image[np.hypot(x - centre[0], y - centre[1]) < 2.4] = ground
    return image


@pytest.mark.parametrize(("dark", "shift_mm"), [(True, 0.0), (False, 9.0), *by_night((True, 9.0), (False, 0.0))])
def test_dots_are_numbered_from_the_markers(dark: bool, shift_mm: float) -> None:
    """Whole and cut off boards, hollow dots included: positions within 5 standard deviations, z as stated."""
    board = GRID.model_copy(update={"dark": dark})
    place = np.array([shift_mm, 0.6 * shift_mm, 660.0])
    clean = with_holes(board, place)
    image = noisy(clean, 7)
    detection = detect_board(image, board)
    assert not detection.reason
    assert len(detection.ids) == 80 if shift_mm == 0 else 40 < len(detection.ids) < 80
    points = refine_points(image, rendered_noise_variance(clean), board, detection)
    assert len(points.ids) > 0.9 * len(detection.ids)
    true = CAMERA.project(board.points_mm[points.ids] @ TURN.T + place)
    true = true + disc_bias(CAMERA, TURN, place, board.points_mm[points.ids], board.diameter_mm / 2)
    z = np.einsum(
        "nij,nj->ni", np.linalg.inv(np.linalg.cholesky(points.covariance_px2)), points.pixels - true
    )  # fmt: skip
    assert np.abs(z).max() < 5
    assert 0.75 < np.sqrt((z**2).mean()) < 1.25


def test_what_does_not_fit_has_a_reason() -> None:
    image = with_holes(GRID, np.array([0.0, 0.0, 660.0]), fine=8)
    assert "hollow dots" in detect_board(render_board(GRID, CAMERA, TURN, np.array([0, 0, 660.0]), fine=8), GRID).reason
    assert detect_board(np.ascontiguousarray(image[:, ::-1]), GRID).reason
    far = GRID.model_copy(update={"markers": ((2, 5), (8, 5), (2, 2))})
    assert "check board.markers" in detect_board(image, far).reason


PRINTS = {
    "dots": {"dots": (10, 8), "spacing_mm": 5.0, "diameter_mm": 2.4, "markers": ((2, 5), (7, 5), (2, 2))},
    "asymmetric_dots": {"dots": (6, 11), "spacing_mm": 8.0, "diameter_mm": 2.4, "markers": ((1, 8), (4, 8), (1, 4))},
}


@pytest.mark.parametrize(("kind", "dark"), [("dots", True), ("asymmetric_dots", True), ("asymmetric_dots", False)])
@pytest.mark.parametrize("shift_mm", [0.0, 9.0])
def test_prints_with_markers_are_read(kind: str, dark: bool, shift_mm: float) -> None:
    """The artwork of a board, rendered, is numbered as its points are, cut off by the border, too."""
    artwork = draw_board(BoardPrint(kind=kind, dark=dark, **PRINTS[kind]))
    board = DotGrid(kind=kind, dark=dark, **PRINTS[kind])
    place = np.array([shift_mm, 0.6 * shift_mm, 660.0])
    placed = PlacedBoard(artwork, TURN, place)
    view = Viewpoint.on_axis(0.0)
    image = BoardRenderer(CAMERA, placed, BoardLight(200.0, 3000.0, 1500.0)).render(0.0, view).astype(np.float64)
    detection = detect_board(image, board)
    assert not detection.reason
    whole = artwork.points_mm.shape[0]
    assert len(detection.ids) == whole if shift_mm == 0 else 0.5 * whole < len(detection.ids) < whole
    points = refine_points(image, 1.0, board, detection)
    true = CAMERA.project(board.points_mm[points.ids] @ TURN.T + place)
    true = true + disc_bias(CAMERA, TURN, place, board.points_mm[points.ids], board.diameter_mm / 2)
    assert len(points.ids) > 0.9 * len(detection.ids)
    assert np.abs(points.pixels - true).max() < 0.02
    mirrored = detect_board(np.ascontiguousarray(image[:, ::-1]), board)
    assert mirrored.reason


@pytest.mark.parametrize(
    ("markers", "kind"),
    [
        (((2, 5), (7, 5), (2, 9)), "dots"),
        (((2, 5), (7, 4), (2, 2)), "dots"),
        (((2, 5), (7, 5), (2, 2)), "asymmetric_dots"),
    ],
)
def test_markers_make_a_right_angle_on_the_grid(markers: object, kind: str) -> None:
    with pytest.raises(ValidationError, match="markers"):
        DotGrid.model_validate({**GRID.model_dump(), "markers": markers, "kind": kind, "diameter_mm": 1.0})

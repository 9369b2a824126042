"""Boards and their detection in rendered images: numbering, orientation, and boards that are not the given one."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.camera import Camera
from scenetruth.capture.calibration import (
    CharucoBoard,
    Checkerboard,
    Detection,
    DotGrid,
    detect_board,
    rotation_matrix,
)
from tests.helpers.rendered_boards import render_board

pytest.importorskip("cv2")

CAMERA = Camera(width=320, height=240, focal_length_px=2500)
CHARUCO = CharucoBoard(kind="charuco", squares=(9, 6), square_mm=8.0, marker_mm=6.0)
CHECKER = Checkerboard(kind="checkerboard", squares=(8, 6), square_mm=7.0)
SYMMETRIC = DotGrid(kind="dots", dots=(7, 5), spacing_mm=9.0, diameter_mm=4.5)
ASYMMETRIC = DotGrid(kind="asymmetric_dots", dots=(4, 7), spacing_mm=14.0, diameter_mm=5.0)
TURN = np.array([0.3, -0.25, 0.2])
PLACE = np.array([1.0, -0.5, 660.0])


def rendered(board: CharucoBoard | Checkerboard | DotGrid, turn: NDArray[np.float64] = TURN) -> NDArray[np.float64]:
    return render_board(board, CAMERA, rotation_matrix(turn), PLACE, fine=8)


def errors(board: CharucoBoard | Checkerboard | DotGrid, found: Detection, turn: NDArray[np.float64] = TURN) -> float:
    true = CAMERA.project(board.points_mm[found.ids] @ rotation_matrix(turn).T + PLACE)
    return float(np.abs(found.pixels - true).max())


@pytest.mark.parametrize("board", [CHARUCO, CHECKER, SYMMETRIC, ASYMMETRIC], ids=lambda board: board.kind)
def test_points_are_those_of_the_board(board: CharucoBoard | Checkerboard | DotGrid) -> None:
    found = detect_board(rendered(board), board)
    assert found.reason == ""
    assert len(found.ids) == len(board.points_mm)
    assert (np.diff(found.ids) > 0).all()
    assert errors(board, found) < 0.6
    assert np.abs(board.points_mm.mean(axis=0)).max() < 1e-9 or board.kind == "asymmetric_dots"


@pytest.mark.parametrize("spin", [0.0, 0.6, -0.9])
def test_a_grid_keeps_its_orientation_over_turns(spin: float) -> None:
    """A detector may begin at either end; the rows point to the right."""
    board = Checkerboard(kind="checkerboard", squares=(7, 5), square_mm=7.0)
    turn = np.array([0.2, 0.1, spin])
    found = detect_board(rendered(board, turn), board)
    assert errors(board, found, turn) < 0.6


def test_mirrored_boards_are_named() -> None:
    assert "mirrored" in detect_board(rendered(CHARUCO)[:, ::-1].copy(), CHARUCO).reason


def test_the_legacy_pattern_is_named() -> None:
    legacy = CHARUCO.model_copy(update={"legacy": True})
    assert "board.legacy to true" in detect_board(rendered(legacy), CHARUCO).reason
    assert detect_board(rendered(legacy), legacy).reason == ""


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"dictionary": "5X5_250"}, r"0 markers .* markers of the dictionary 4X4_1000: check board\.dictionary"),
        ({"squares": (13, 6)}, r"markers and 0 corners .*check board\.squares"),
    ],
)
def test_another_dictionary_and_other_squares_are_named(changes: dict[str, object], remedy: str) -> None:
    stated = CHARUCO.model_copy(update=changes)
    assert re.search(remedy, detect_board(rendered(CHARUCO), stated).reason)


def test_parts_of_a_charuco_board_are_sufficient_and_of_others_not() -> None:
    image = rendered(CHARUCO)
    image[:, :120] = image.max()
    found = detect_board(image, CHARUCO)
    assert 6 <= len(found.ids) < len(CHARUCO.points_mm)
    assert errors(CHARUCO, found) < 0.6
    image = rendered(CHECKER)
    image[:, :120] = image.max()
    assert "must be visible" in detect_board(image, CHECKER).reason


def test_empty_images_have_no_board() -> None:
    for board in (CHARUCO, CHECKER, SYMMETRIC):
        assert detect_board(np.full((240, 320), np.nan), board).reason
        assert detect_board(np.full((240, 320), 7.0), board).reason


@pytest.mark.parametrize(
    ("cls", "fields", "message"),
    [
        (CharucoBoard, {"kind": "charuco", "squares": (5, 4), "square_mm": 5, "marker_mm": 6}, "marker_mm"),
        (Checkerboard, {"kind": "checkerboard", "squares": (3, 6), "square_mm": 5}, "at least 4 x 4"),
        (DotGrid, {"kind": "dots", "dots": (5, 4), "spacing_mm": 5, "diameter_mm": 4.5}, "diameter_mm"),
    ],
)
def test_impossible_boards_are_rejected(cls: type, fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        cls(**fields)

"""Artwork of boards: as OpenCV draws them, points in its order, and what no board can be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenetruth.camera import Camera, Viewpoint
from scenetruth.capture import (
    BoardArtwork,
    BoardLight,
    BoardPrint,
    BoardRenderer,
    PlacedBoard,
    draw_board,
    read_board_print,
)
from scenetruth.errors import ArgumentError

PX_PER_MM = 4


def frontal(artwork: BoardArtwork) -> Any:
    """Render the whole plate from the front, at PX_PER_MM pixels per mm."""
    left, top, right, bottom = artwork.box_mm
    camera = Camera(
        width=round((right - left) * PX_PER_MM), height=round((bottom - top) * PX_PER_MM), focal_length_px=400
    )
    middle = artwork.centre_mm - [(left + right) / 2, (top + bottom) / 2]
    placed = PlacedBoard(artwork, np.eye(3), np.array([*middle, 400 / PX_PER_MM]))
    return BoardRenderer(camera, placed, BoardLight(0.0, 1.0, 0.5)).render(0.0, Viewpoint.on_axis(0.0))


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("squares", [(6, 4), (5, 5), (7, 6)])
def test_charuco_boards_are_those_of_opencv(squares: tuple[int, int], legacy: bool) -> None:
    aruco = pytest.importorskip("cv2").aruco
    board = BoardPrint(
        kind="charuco", squares=squares, square_mm=12, marker_mm=9, dictionary="5X5_100", legacy=legacy
    )  # fmt: skip
    layout = aruco.CharucoBoard(squares, 12.0, 9.0, aruco.getPredefinedDictionary(aruco.DICT_5X5_100))
    layout.setLegacyPattern(legacy)
    artwork = draw_board(board)
    np.testing.assert_allclose(artwork.points_mm, layout.getChessboardCorners()[:, :2], atol=1e-5)
    size = tuple((side * 12 + 24) * PX_PER_MM for side in squares)
    # Squares, and the cells of markers, whose side of 9 mm is 36 px for 7 cells, are compared in whole pixels.
    expected = layout.generateImage(size, marginSize=12 * PX_PER_MM) / 255
    image = frontal(artwork)
    whole = np.abs(image - 0.5) > 0.499
    assert whole.mean() > 0.9
    assert (np.abs(image - expected)[whole] < 1e-6).mean() > 0.98


def test_charuco_cells_of_whole_pixels_are_exactly_those_of_opencv() -> None:
    aruco = pytest.importorskip("cv2").aruco
    layout = aruco.CharucoBoard((6, 4), 12.0, 9.0, aruco.getPredefinedDictionary(aruco.DICT_4X4_250))
    board = BoardPrint(kind="charuco", squares=(6, 4), square_mm=12, marker_mm=9, dictionary="4X4_250")
    # 36 px for 6 cells.
    expected = layout.generateImage((96 * PX_PER_MM, 72 * PX_PER_MM), marginSize=12 * PX_PER_MM) / 255
    np.testing.assert_allclose(frontal(draw_board(board)), expected, rtol=0, atol=1e-6)


def test_checkerboards_are_black_at_their_origin() -> None:
    artwork = draw_board(BoardPrint(kind="checkerboard", squares=(5, 4), square_mm=10))
    assert artwork.points_mm.tolist() == [[10 * x, 10 * y] for y in (1, 2, 3) for x in (1, 2, 3, 4)]
    image = frontal(artwork).reshape(6, 40, 7, 40).mean(axis=(1, 3))
    expected = np.pad(np.indices((4, 5)).sum(axis=0) % 2, 1, constant_values=1)
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-6)


def test_areas_of_dots_are_those_of_discs() -> None:
    artwork = draw_board(BoardPrint(kind="dots", dots=(4, 3), spacing_mm=7, diameter_mm=3))
    assert artwork.points_mm.tolist() == [[7 * x, 7 * y] for y in (0, 1, 2) for x in (0, 1, 2, 3)]
    dark_mm2 = (1 - frontal(artwork)).sum() / PX_PER_MM**2
    assert dark_mm2 == pytest.approx(12 * np.pi * 1.5**2, rel=1e-6)


def test_bright_and_hollow_dots_leave_the_ground() -> None:
    """Ink on the plate: all of it but the discs for bright dots; holes have a third of the diameter."""
    fields: dict[str, Any] = {"kind": "dots", "dots": (4, 3), "spacing_mm": 7, "diameter_mm": 3}
    markers = ((1, 1), (3, 1), (1, 0))
    disc = np.pi * 1.5**2
    hollow = draw_board(BoardPrint(**fields, markers=markers))
    dark_mm2 = (1 - frontal(hollow)).sum() / PX_PER_MM**2
    assert dark_mm2 == pytest.approx((12 - 3 / 9) * disc, rel=1e-6)
    bright_mm2 = frontal(draw_board(BoardPrint(**fields, markers=markers, dark=False))).sum() / PX_PER_MM**2
    assert bright_mm2 == pytest.approx((12 - 3 / 9) * disc, rel=1e-6)


def test_asymmetric_dots_are_in_the_order_of_opencv() -> None:
    artwork = draw_board(BoardPrint(kind="asymmetric_dots", dots=(4, 11), spacing_mm=10, diameter_mm=4))
    # As in the documentation of cv2.findCirclesGrid: ((2 j + i % 2) s, i s) with s half the distance in a row.
    assert artwork.points_mm.tolist() == [[5.0 * (2 * j + i % 2), 5.0 * i] for i in range(11) for j in range(4)]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, r"board\.kind: is missing"),
        ({"kind": "rings"}, r"board\.kind: .*'charuco'"),
        ({"kind": "charuco"}, r"board: .*lacks squares, square_mm, marker_mm, dictionary"),
        ({"kind": "checkerboard", "squares": [5, 4], "square_mm": 5, "marker_mm": 4}, r"must not have marker_mm"),
        (
            {"kind": "charuco", "squares": [5, 4], "square_mm": 5, "marker_mm": 5, "dictionary": "4X4_50"},
            r"markers of 5 mm, which do not fit",
        ),
        ({"kind": "dots", "dots": [5, 4], "spacing_mm": 5, "diameter_mm": 4.5}, r"dots of 4\.5 mm, more than 0\.8"),
        ({"kind": "checkerboard", "squares": [5, 4], "square_mm": 5, "dark": False}, "must not have dark: false"),
        (
            {"kind": "dots", "dots": [5, 4], "spacing_mm": 5, "diameter_mm": 2, "markers": [[1, 1], [3, 1], [1, 4]]},
            r"markers that must lie on the grid of 5 x 4",
        ),
        (
            {
                "kind": "asymmetric_dots",
                "dots": [5, 8],
                "spacing_mm": 5,
                "diameter_mm": 2,
                "markers": [[1, 1], [3, 1], [1, 4]],
            },
            r"another in its column, an even number of rows away",
        ),
    ],
)
def test_what_no_board_can_be_is_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        read_board_print(values)


@pytest.mark.parametrize(
    ("dictionary", "squares", "message"),
    [
        ("4X4_51", (5, 4), "must be a dictionary of OpenCV: .*4X4_50"),
        ("4X4_50", (12, 9), "has 50 markers, .* needs 54"),
    ],
)
def test_dictionaries_must_exist_and_suffice(dictionary: str, squares: tuple[int, int], message: str) -> None:
    pytest.importorskip("cv2")
    board = BoardPrint(kind="charuco", squares=squares, square_mm=5, marker_mm=4, dictionary=dictionary)
    with pytest.raises(ArgumentError, match=message):
        draw_board(board)

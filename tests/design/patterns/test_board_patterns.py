"""Calibration boards to print: found by OpenCV, at true scale, on one page, with their section of a capture file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image

from scenetruth.capture import BoardKind
from scenetruth.design.patterns import InkAreas, Pattern, PatternRig, export_board, generate_board
from scenetruth.errors import ArgumentError
from tests.helpers.nightly import by_night, nightly

RIG = PatternRig.from_scene(focal_length_px=2500, distance_mm=600, image_size_px=(640, 480))
KINDS: list[BoardKind] = ["charuco", "checkerboard", "dots", "asymmetric_dots"]


@pytest.fixture(params=["charuco", "asymmetric_dots", *by_night("checkerboard", "dots")])
def board(request: pytest.FixtureRequest) -> Pattern:
    if request.param == "charuco":
        pytest.importorskip("cv2")
    return generate_board(RIG, request.param)


def test_boards_are_found_by_opencv(board: Pattern, tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    export_board(board, tmp_path, page="A3")
    with Image.open(tmp_path / "board.png") as picture:
        # OpenCV finds no blobs of more than 5000 px.
        image = np.ascontiguousarray(picture.reduce(3))
    section = yaml.safe_load((tmp_path / "board.yaml").read_text())["board"]
    texel_mm = board.size_mm[0] / image.shape[1]
    kind = section["kind"]
    found: Any
    if kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{section['dictionary']}"))
        layout = cv2.aruco.CharucoBoard(section["squares"], section["square_mm"], section["marker_mm"], dictionary)
        found, ids, *_ = cv2.aruco.CharucoDetector(layout).detectBoard(image)
        assert ids.ravel().tolist() == list(range(88))
        step_mm, columns = section["square_mm"], 11
    elif kind == "checkerboard":
        columns, rows = (count - 1 for count in section["squares"])
        complete, found = cv2.findChessboardCornersSB(image, (columns, rows))
        assert complete
        step_mm = section["square_mm"]
    else:
        columns, rows = section["dots"]
        flags = cv2.CALIB_CB_SYMMETRIC_GRID if kind == "dots" else cv2.CALIB_CB_ASYMMETRIC_GRID
        complete, found = cv2.findCirclesGrid(image, (columns, rows), flags=flags)
        assert complete
        step_mm = section["spacing_mm"]
    points = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    across = np.linalg.norm(points[columns - 1] - points[0]) / (columns - 1) * texel_mm
    # Corners are found to about 0.1 of a texel of 0.18 mm, over a row of at least three steps of 13 mm.
    assert across == pytest.approx(step_mm, rel=2e-3)


@nightly
def test_pages_are_at_true_scale(board: Pattern, tmp_path: Path) -> None:
    export_board(board, tmp_path, page="A3")
    root = ElementTree.parse(tmp_path / "board.svg").getroot()
    assert {root.get("width"), root.get("height")} == {"297mm", "420mm"}
    group = next(each for each in root.iter() if each.get("id") == "pattern")
    marks = board.marks((0.0, 0.0, *board.size_mm))
    svg = "{http://www.w3.org/2000/svg}"
    if isinstance(marks, InkAreas):
        # One path for all areas, so that no seams show between cells.
        (path,) = group.iter(f"{svg}path")
        outlines = re.findall(r"M([-\d.]+) ([-\d.]+)l([^z]*)z", path.get("d") or "")
        assert len(outlines) == len(marks.outlines_mm)
        areas = []
        for x, y, steps in outlines:
            numbers = np.array(steps.split(), dtype=np.float64).reshape(-1, 2)
            corners = np.vstack([[0, 0], np.cumsum(numbers, axis=0)]) + [float(x), float(y)]
            shifted = np.roll(corners, -1, axis=0)
            areas.append(0.5 * np.sum(corners[:, 0] * shifted[:, 1] - shifted[:, 0] * corners[:, 1]))
        total = sum(areas)
    else:
        circles = list(group.iter(f"{svg}circle"))
        total = sum(np.pi * float(circle.get("r") or 0) ** 2 for circle in circles)
    texels = (4 * round(board.size_mm[1] * 10), 4 * round(board.size_mm[0] * 10))
    ink_mm2 = board.drawing.ink((0.0, 0.0, *board.size_mm), texels).mean(dtype=np.float64) * np.prod(board.size_mm)
    # Outlines are written in whole µm.
    assert total == pytest.approx(ink_mm2, rel=1e-3)


def test_section_of_the_capture_file_is_that_of_the_board(board: Pattern, tmp_path: Path) -> None:
    export_board(board, tmp_path, page="A3")
    section = yaml.safe_load((tmp_path / "board.yaml").read_text())["board"]
    assert section.pop("scale_std") == 1e-3
    again = generate_board(RIG, **{"type": section.pop("kind")}, **section)
    np.testing.assert_array_equal(
        again.drawing.ink((0, 0, *again.size_mm), (90, 120)), board.drawing.ink((0, 0, *board.size_mm), (90, 120))
    )


def test_boards_are_not_cut_into_pages(tmp_path: Path) -> None:
    large = generate_board(RIG, "checkerboard", squares=(9, 6), square_mm=40)
    with pytest.raises(ArgumentError, match=r"page: does not hold the board of 440 x 320 mm"):
        export_board(large, tmp_path)
    assert not list(tmp_path.iterdir())


def test_lengths_are_all_or_none() -> None:
    with pytest.raises(ArgumentError, match="lacks marker_mm, dictionary"):
        generate_board(RIG, "charuco", squares=(9, 6), square_mm=8)
    with pytest.raises(ArgumentError, match="the rig has no image size"):
        generate_board(PatternRig.from_scene(focal_length_px=2500, distance_mm=600))

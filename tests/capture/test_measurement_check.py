"""Images of a measurement against the calibration: agreement, direction, turned camera; and starts of poses."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.ndimage import rotate

from scenetruth.capture import RigCalibration, compare_measurement, import_capture, open_capture
from scenetruth.capture.calibration import (
    CharucoBoard,
    charuco_board,
    detect_board,
)
from scenetruth.errors import CaptureWarning
from tests.helpers.board_captures import changed_capture
from tests.helpers.captured_folders import store

Calibrated = tuple[RigCalibration, Path]


def test_images_of_the_calibrated_rig_agree(board_capture: Path, board_calibration: Calibrated) -> None:
    assert compare_measurement(open_capture(board_capture), board_calibration[0]) == []


def test_images_turned_by_half_a_turn_are_named(
    board_capture: Path, board_calibration: Calibrated, tmp_path: Path
) -> None:
    folder = changed_capture(board_capture, tmp_path / "lab")
    for file in folder.glob("images/*.tif"):
        store(file, np.ascontiguousarray(tifffile.imread(file)[::-1, ::-1]))
    (message,) = compare_measurement(open_capture(folder), board_calibration[0])
    assert "opposite direction" in message
    assert "reverse the positions" in message


def test_a_turned_camera_is_named(board_capture: Path, board_calibration: Calibrated, tmp_path: Path) -> None:
    """A turn by 2 degrees about the optical axis displaces images across the stage by 0.035 of their displacement."""
    folder = changed_capture(board_capture, tmp_path / "lab")
    for file in folder.glob("images/*.tif"):
        values = tifffile.imread(file)
        turned = rotate(values.astype(float), 2.0, reshape=False, order=3, mode="nearest")
        store(file, np.clip(np.rint(turned), 0, 4095).astype(values.dtype))
    (message,) = compare_measurement(open_capture(folder), board_calibration[0])
    assert "knocked" in message
    assert "calibrate again" in message


def test_positions_that_the_calibration_knows_are_no_knock(
    board_capture: Path, board_calibration: Calibrated, tmp_path: Path
) -> None:
    """A camera that is lower by z / f at one position sees the wall higher by one pixel there."""
    folder, (calibration, _) = changed_capture(board_capture, tmp_path / "lab"), board_calibration
    for file in folder.glob("images/s-1_*.tif"):
        store(file, np.roll(tifffile.imread(file), -1, axis=0))
    values = calibration.values.copy()
    values[calibration.names.index("position[0].y")] += 660 / calibration.value("f")
    assert compare_measurement(open_capture(folder), replace(calibration, values=values)) == []
    (message,) = compare_measurement(open_capture(folder), calibration)
    assert "across the stage" in message


def test_a_calibration_of_another_lens_is_named_at_the_import(
    board_capture: Path, board_calibration: Calibrated
) -> None:
    """Of the same size, bits and positions; a depth of 1.3 times the stated distance shows it as well."""
    calibration, values = board_calibration[0], board_calibration[0].values.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        import_capture(board_capture, calibration=calibration)
    values[calibration.names.index("f")] *= 1.3
    with pytest.warns(CaptureWarning) as caught:
        import_capture(board_capture, calibration=replace(calibration, values=values))
    texts = [str(each.message) for each in caught]
    assert any("use the calibration of this camera and lens, or correct camera.focal_length_px" in one for one in texts)
    assert any("but distance_mm is 660" in one for one in texts)


def test_a_calibration_of_another_stage_axis_is_named_at_the_import(
    board_capture: Path, board_calibration: Calibrated
) -> None:
    calibration, values = board_calibration[0], board_calibration[0].values.copy()
    values[calibration.names.index("axis_y")] += 0.03
    with pytest.warns(CaptureWarning, match="displaced across the stage"):
        import_capture(board_capture, calibration=replace(calibration, values=values))


def test_two_boards_in_an_image_are_named() -> None:
    board = CharucoBoard(kind="charuco", squares=(6, 5), square_mm=5.0, marker_mm=3.7)
    one = charuco_board(board).generateImage((240, 200), marginSize=10)
    assert detect_board(one.astype(float), board).reason == ""
    both = np.concatenate([one, one], axis=1)
    assert "show one board at a time" in detect_board(both.astype(float), board).reason

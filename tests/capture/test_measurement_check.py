"""Images of a measurement against the calibration: agreement, direction, turned camera; and starts of poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import rotate

from scenetruth.capture import RigCalibration, compare_measurement, open_capture
from scenetruth.capture.calibration import (
    CharucoBoard,
    RigGuess,
    RigPriors,
    RigState,
    charuco_board,
    detect_board,
    project,
    restart_poses,
    rotation_matrix,
    start_state,
)
from scenetruth.capture.capture_calibration import load_points
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


def test_poses_with_a_wrong_tilt_are_started_again(board_calibration: Calibrated) -> None:
    found, output = board_calibration
    given = load_points(output / "calibration_points.npz")
    state = start_state(given, RigPriors(), RigGuess(focal_length_px=found.value("f")))
    turns = state.turns.copy()
    turns[1] = rotation_matrix(np.array([0.9, -0.9, 0.0])) @ turns[1]
    wrong = RigState(state.layout, state.values, turns)
    again = restart_poses(given, wrong, [state.layout.poses[1]])
    rms = [
        np.sqrt(np.mean((given.pixels - project(given, each, derivatives=False)[0]) ** 2)) for each in (wrong, again)
    ]
    assert rms[1] < 1
    assert rms[0] > 3 * rms[1]


def test_two_boards_in_an_image_are_named() -> None:
    board = CharucoBoard(kind="charuco", squares=(6, 5), square_mm=5.0, marker_mm=3.7)
    one = charuco_board(board).generateImage((240, 200), marginSize=10)
    assert detect_board(one.astype(float), board).reason == ""
    both = np.concatenate([one, one], axis=1)
    assert "show one board at a time" in detect_board(both.astype(float), board).reason

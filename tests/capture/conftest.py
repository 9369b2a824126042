"""Simulated captures that the tests of captures share."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from scenetruth.capture import RigCalibration, calibrate_capture
from tests.helpers.board_captures import make_board_capture
from tests.helpers.shared_folders import make_once


@pytest.fixture(scope="session")
def board_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a simulated capture with a board."""
    made = make_once(tmp_path_factory, "board_capture", lambda folder: make_board_capture(folder / "capture"))
    return made / "capture"


@pytest.fixture(scope="session")
def board_calibration(board_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RigCalibration, Path]:
    """Return its calibration, and the directory of the files."""

    def make(folder: Path) -> None:
        found = calibrate_capture(board_capture, output=folder / "files")
        (folder / "found.pickle").write_bytes(pickle.dumps(found))

    made = make_once(tmp_path_factory, "board_calibration", make)
    found: RigCalibration = pickle.loads((made / "found.pickle").read_bytes())
    return found, made / "files"

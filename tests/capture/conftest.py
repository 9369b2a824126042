"""Simulated captures that the tests of captures share."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.capture import RigCalibration, calibrate_capture
from tests.helpers.board_captures import make_board_capture


@pytest.fixture(scope="session")
def board_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a simulated capture with a board."""
    return make_board_capture(tmp_path_factory.mktemp("board_capture") / "capture")


@pytest.fixture(scope="session")
def board_calibration(board_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RigCalibration, Path]:
    """Return its calibration, and the directory of the files."""
    output = tmp_path_factory.mktemp("board_calibration")
    return calibrate_capture(board_capture, output=output), output

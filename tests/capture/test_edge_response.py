"""Exponent of the response from edges: rendered boards with a known encoding."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import Camera
from scenetruth.capture import fit_edge_exponent
from scenetruth.capture.calibration import Checkerboard, DotGrid, rotation_matrix
from tests.helpers.nightly import by_night
from tests.helpers.rendered_boards import noisy, render_board

Floats = NDArray[np.float64]
FULL = 4095.0
CHECKERBOARD = Checkerboard(kind="checkerboard", squares=(8, 7), square_mm=5.0)
DOTS = DotGrid(kind="dots", dots=(8, 6), spacing_mm=5.0, diameter_mm=2.9)
BOARDS = pytest.mark.parametrize("board", [CHECKERBOARD, DOTS], ids=["squares", "dots"])


@cache
def image_of(kind: str, seed: int = 1) -> Floats:
    """Return a linear image of a tilted board with noise."""
    camera = Camera(width=240, height=200, focal_length_px=2400)
    turn = rotation_matrix(np.array([0.25, 0.2, 0.1]))
    board = CHECKERBOARD if kind == "checkerboard" else DOTS
    clean = render_board(board, camera, turn, np.array([0.3, -0.2, 500.0]), blur_px=0.7, fine=8)
    return np.asarray(noisy(clean, seed).astype(np.float64))


def encoded(board: Checkerboard | DotGrid, gamma: float) -> Floats:
    return np.asarray(np.rint(FULL * (np.clip(image_of(board.kind), 0, FULL) / FULL) ** gamma))


@BOARDS
@pytest.mark.parametrize("gamma", [0.6, *by_night(0.45)])
def test_encodings_are_measured(board: Checkerboard | DotGrid, gamma: float) -> None:
    found = fit_edge_exponent([encoded(board, gamma)], board, FULL)
    assert abs(found.exponent - gamma) < 0.1
    assert found.exponent + 4 * found.std < 0.78


@BOARDS
def test_linear_images_are_not_called_encoded(board: Checkerboard | DotGrid) -> None:
    found = fit_edge_exponent([encoded(board, 1.0)], board, FULL)
    assert not found.exponent < 0.78  # NaN if the noise leaves it open


def test_images_without_a_board_or_saturated_have_no_exponent() -> None:
    assert np.isnan(fit_edge_exponent([np.full((100, 120), 300.0)], CHECKERBOARD, FULL).exponent)
    saturated = np.minimum(2 * encoded(CHECKERBOARD, 1.0), FULL)
    assert np.isnan(fit_edge_exponent([saturated], CHECKERBOARD, FULL).exponent)

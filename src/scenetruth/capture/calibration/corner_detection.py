"""Detection of boards in images by OpenCV: start positions of corners and dots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.boards import Board, CharucoBoard, Checkerboard, DotGrid
from scenetruth.capture.calibration.dot_detection import match_marked_grid
from scenetruth.capture.calibration.rig_model import CalibrationError
from scenetruth.errors import Problem

__all__ = ["Detection", "charuco_board", "detect_board", "stretched"]

Array = NDArray[np.float64]

_FAMILIES = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "APRILTAG_36h11", "APRILTAG_25h9")
"""Dictionaries that contain the smaller dictionaries of their size."""

_FEWEST = 6  # corners of a ChArUco board
_DARK, _BRIGHT = 1.0, 99.5  # percentiles of black and white


@dataclass(frozen=True, eq=False)
class Detection:
    """Points of a board in one image.

    ``ids``: Indices of the points in `Board.points_mm`, shape (n,).
    ``pixels``: Their positions, accurate to some tenths of a pixel, shape (n, 2).
    ``reason``: Why nothing was detected; empty if something was.
    """

    ids: NDArray[np.int64]
    pixels: Array
    reason: str = ""


def _nothing(reason: str) -> Detection:
    return Detection(np.empty(0, dtype=np.int64), np.empty((0, 2)), reason)


def stretched(image: Array) -> NDArray[np.uint8]:
    """Return an image as 8 bits, black at its 1st and white at its 99.5th percentile; NaN is black."""
    finite = image[np.isfinite(image)]
    if finite.size == 0:
        return np.zeros(image.shape, dtype=np.uint8)
    low, high = np.percentile(finite, (_DARK, _BRIGHT))
    scaled = (np.nan_to_num(image, nan=low) - low) * (255 / max(float(high - low), 1e-12))
    return np.asarray(np.clip(np.rint(scaled), 0, 255), dtype=np.uint8)


def opencv() -> Any:
    """Return the module of OpenCV."""
    try:
        import cv2
    except ImportError as error:
        remedy = "install it: pip install 'scenetruth[opencv]' (or opencv-python-headless)"
        problem = Problem("board", f"is detected by OpenCV, which cannot be imported ({error}); {remedy}")
        raise CalibrationError([problem]) from error
    return cv2


def charuco_board(board: CharucoBoard) -> Any:
    """Return the board of OpenCV."""
    cv2 = opencv()
    number = getattr(cv2.aruco, f"DICT_{board.dictionary.upper()}", None)
    if number is None:
        names = sorted(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_"))
        message = f"is no dictionary of OpenCV; use one of {', '.join(names)}"
        raise CalibrationError([Problem("board.dictionary", message, board.dictionary)])
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    needed, available = board.squares[0] * board.squares[1] // 2, len(dictionary.bytesList)
    if needed > available:
        message = f"has {available} markers, and the board needs {needed}; use a larger dictionary"
        raise CalibrationError([Problem("board.dictionary", message, board.dictionary)])
    made = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, dictionary)
    made.setLegacyPattern(board.legacy)
    return made


def detect_board(image: Array, board: Board) -> Detection:
    """Return the points of a board in a grey image of shape (rows, columns)."""
    if isinstance(board, CharucoBoard):
        return _detect_charuco(image, board)
    found = _detect_squares(image, board) if isinstance(board, Checkerboard) else _detect_dots(image, board)
    return found if found.reason or _is_unique(board) else _oriented(found, board)


def _is_unique(board: Checkerboard | DotGrid) -> bool:
    """Return whether the detector determines the orientation."""
    return isinstance(board, DotGrid) and board.markers is not None


def _detect_charuco(image: Array, board: CharucoBoard) -> Detection:
    cv2 = opencv()
    grey = stretched(image)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(charuco_board(board)).detectBoard(grey)
    count = 0 if ids is None else len(ids)
    seen = 0 if markers is None else len(markers)
    twice = seen - len(np.unique(markers)) if seen else 0
    if twice > 1:
        return _nothing(f"{twice} markers occur twice: two boards, or a reflection; show one board at a time")
    if seen >= 2 and count < max(_FEWEST, seen // 4):
        other = board.model_copy(update={"legacy": not board.legacy})
        again = cv2.aruco.CharucoDetector(charuco_board(other)).detectBoard(grey)[1]
        if again is not None and len(again) > 2 * max(count, _FEWEST // 2):
            word = "true" if other.legacy else "false"
            return _nothing(f"{seen} markers fit the other pattern of OpenCV; set board.legacy to {word}")
    if count < _FEWEST:
        mirrored = cv2.aruco.CharucoDetector(charuco_board(board)).detectBoard(np.ascontiguousarray(grey[:, ::-1]))[1]
        if mirrored is not None and len(mirrored) >= _FEWEST:
            return _nothing("the board is mirrored; read the images without flipping them")
        remedy = _remedy(grey, board, seen)
        return _nothing(f"{seen} markers and {count} corners detected, of at least {_FEWEST}{remedy}")
    numbers = np.asarray(ids, dtype=np.int64).ravel()
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return Detection(numbers, pixels)


def _remedy(grey: NDArray[np.uint8], board: CharucoBoard, seen: int) -> str:
    """Return what is wrong with a board whose corners are not found."""
    if seen >= _FEWEST:
        return "; check board.squares"
    cv2, counts = opencv(), {}
    for name in _FAMILIES:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        ids = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)[1]
        counts[name] = 0 if ids is None else len(np.unique(ids))
    best = max(counts, key=lambda name: counts[name])
    if counts[best] < max(_FEWEST, 2 * seen):
        return ""
    return f"; {counts[best]} markers of the dictionary {best}: check board.dictionary, which is {board.dictionary}"


def _detect_squares(image: Array, board: Checkerboard) -> Detection:
    cv2 = opencv()
    size = (board.squares[0] - 1, board.squares[1] - 1)
    grey = stretched(image)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    done, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not done:
        done, corners = cv2.findChessboardCorners(grey, size)
    if not done:
        return _nothing(
            f"no checkerboard with {size[0]} x {size[1]} inner corners; all of them must be visible, of one board"
        )
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return Detection(np.arange(len(pixels)), pixels)


def _detect_dots(image: Array, board: DotGrid) -> Detection:
    cv2 = opencv()
    grey = stretched(image) if board.dark else 255 - stretched(image)
    if board.markers is not None:
        return Detection(*match_marked_grid(grey, board))
    settings = cv2.SimpleBlobDetector_Params()
    # Any size that a dot of a fully visible grid can have.
    settings.minArea, settings.maxArea = 12.0, grey.size / (2.0 * board.dots[0] * board.dots[1])
    settings.minDistBetweenBlobs = 3.0
    layout = cv2.CALIB_CB_SYMMETRIC_GRID if board.kind == "dots" else cv2.CALIB_CB_ASYMMETRIC_GRID
    detector = cv2.SimpleBlobDetector.create(settings)
    for flags in (layout, layout | cv2.CALIB_CB_CLUSTERING):
        done, centres = cv2.findCirclesGrid(grey, board.dots, flags=flags, blobDetector=detector)
        if done:
            pixels = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
            return Detection(np.arange(len(pixels)), pixels)
    return _nothing(f"no grid of {board.dots[0]} x {board.dots[1]} dots; all of them must be visible, of one grid")


def _oriented(found: Detection, board: Checkerboard | DotGrid) -> Detection:
    """Return a detection with indices such that the board is not mirrored, and its rows point to the right.

    A grid looks the same after half a turn, so that the detector may begin at either end.
    """
    points = board.points_mm[:, :2]
    best: tuple[float, NDArray[np.int64]] | None = None
    for flip_u in (1, -1):
        for flip_v in (1, -1):
            changed = points[found.ids] * [flip_u, flip_v]
            distances = np.abs(points[None] - changed[:, None]).max(axis=2)
            ids = distances.argmin(axis=1)
            if distances.min(axis=1).max() > 1e-6:
                continue
            affine = np.linalg.lstsq(np.column_stack([points[ids], np.ones(len(ids))]), found.pixels, rcond=None)[0]
            if np.linalg.det(affine[:2]) < 0:
                continue
            # Slightly turned, so that boards at 90 degrees keep one orientation.
            right = float(affine[0] @ [1.0, 0.2])
            if best is None or right > best[0]:
                best = (right, ids.astype(np.int64))
    if best is None:
        return _nothing("the board is mirrored; read the images without flipping them")
    order = np.argsort(best[1])
    return Detection(best[1][order], found.pixels[order])

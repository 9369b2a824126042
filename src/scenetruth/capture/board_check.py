"""Check of board images by themselves: saturation, sharpness, and the response that the edges of the board show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from scenetruth.capture.calibration import Board, CalibrationError
from scenetruth.capture.corrections import PatternMatch
from scenetruth.capture.edge_response import fit_edge_exponent
from scenetruth.capture.file_patterns import MatchedFile
from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.ingest import list_missing
from scenetruth.capture.radiometry import GammaFit
from scenetruth.progress import Progress

__all__ = [
    "BoardStatistics",
    "blurred_boards",
    "board_of",
    "describe_blurred",
    "read_boards",
    "saturated_boards",
    "sharpness",
]

Floats = NDArray[np.float64]

_PLATEAU = 0.02  # share of the pixels of a board image that may be saturated
_DULL = 0.75  # sharpness relative to images of the same kind: a blur of 0.6 px that grows by 0.6 px has 0.7
_LEAST_MATES = 2
_DARK, _BRIGHT, _STEEP = 1.0, 99.5, 99.5  # percentiles
_STRIDE = 3
_EDGE_IMAGES, _EDGE_PIXELS = 6, 2e7


@dataclass
class BoardStatistics:
    """Statistics of all board images.

    ``saturated``: Share of saturated pixels, by the name of the file.
    ``sharpness``: Sharpness by the name of the file.
    ``exponent``: Exponent of the response from the edges of the board; None if it was not measured.
    """

    saturated: dict[str, float] = field(default_factory=dict)
    sharpness: dict[str, float] = field(default_factory=dict)
    exponent: GammaFit | None = None


def sharpness(values: NDArray[Any]) -> float:
    """Return the steepest differences of neighbouring pixels of an image, relative to its contrast."""
    grey = values.astype(np.float64) if values.ndim == 2 else values.mean(axis=-1)
    steps = np.hypot(grey[1:, 1:] - grey[1:, :-1], grey[1:, 1:] - grey[:-1, 1:])
    low, high = np.percentile(grey[::_STRIDE, ::_STRIDE], (_DARK, _BRIGHT))
    return float(np.percentile(steps[::2, ::2], _STEEP) / max(high - low, 1e-9))


def describe_blurred(values: Mapping[str, float], groups: Mapping[str, object], what: str) -> list[str]:
    """Return a message for each image that is less sharp than the others of its group."""
    found = []
    members: dict[object, list[str]] = {}
    for name in values:
        members.setdefault(groups[name], []).append(name)
    for names in members.values():
        if len(names) <= _LEAST_MATES:
            continue
        usual = float(np.median([values[name] for name in names]))
        for name in names:
            if values[name] < _DULL * usual:
                times = usual / max(values[name], 1e-3 * usual)
                found.append(
                    f"{name}: is blurred: its edges are {times:.1f} times as wide as in the other {what}; check its "
                    "sharpness (focus, motion, vibration), and repeat it or remove it"
                )
    return found


def read_boards(
    folder: CaptureFolder, pattern: PatternMatch | None = None, progress: Progress | None = None
) -> BoardStatistics:
    """Read every board image once, and return its statistics.

    ``pattern``: Test of the dark frames, to which the images are added.
    """
    found, pixels = BoardStatistics(), folder.images.pixels
    full, mosaic = pixels.full_scale, pixels.bayer is not None and pixels.plane == "mosaic"
    chosen, examples = _examples(folder), list[Floats]()
    for number, (_, name) in enumerate(sorted(folder.board.items())):
        values = folder.images.read(MatchedFile(name, {}))
        found.saturated[name] = float(np.mean(values >= full))
        if not mosaic:
            found.sharpness[name] = sharpness(values)
        if name in chosen and pixels.encoding == "linear" and not mosaic and values.ndim == 2:
            examples.append(values.astype(np.float64))
        if pattern is not None and values.ndim == 2:
            pattern.add(values)
        if progress is not None:
            progress("check boards", number + 1, len(folder.board))
    if examples and folder.capture.board is not None:
        try:
            found.exponent = fit_edge_exponent(examples, board_of(folder), full)
        except CalibrationError:
            # The calibration states what is missing.
            found.exponent = None
    return found


def _examples(folder: CaptureFolder) -> set[str]:
    """Return board images for the response: of different poses, from the middle of the stage."""
    positions = sorted({s for _, _, s in folder.board})
    middle = positions[(len(positions) - 1) // 2] if positions else 0
    names = list(dict.fromkeys(
        name for (_, _, s), name in sorted(folder.board.items(), key=lambda each: (abs(each[0][2] - middle), each[0]))
    ))  # fmt: skip
    height, width, *_ = folder.images.shape
    count = int(np.clip(_EDGE_PIXELS / (height * width), 1, _EDGE_IMAGES))
    return set(names[:count])


def board_of(folder: CaptureFolder) -> Board:
    """Return the board of a capture file as a board of the detection."""
    section = folder.capture.board
    assert section is not None  # given together with its files
    found: Board = TypeAdapter(Board).validate_python(section.stated())
    return found


def saturated_boards(statistics: BoardStatistics) -> str:
    """Return a message on saturated board images; empty if there are none."""
    shares = {name: share for name, share in statistics.saturated.items() if share > _PLATEAU}
    if not shares:
        return ""
    worst = max(shares, key=lambda name: shares[name])
    return (
        f"{len(shares):,} of {len(statistics.saturated):,} board images have more than {100 * _PLATEAU:g} % of "
        f"saturated pixels (up to {100 * shares[worst]:.3g} % in {worst}): shorten the exposure; their edges are "
        f"displaced: {list_missing(sorted(shares)[:3])}"
    )


def blurred_boards(folder: CaptureFolder, statistics: BoardStatistics) -> list[str]:
    """Return messages on board images that are less sharp than others of their pose, or of all poses."""
    poses = {name: pose for (pose, _, _), name in folder.board.items()}
    single = len(set(poses.values())) == len(poses)
    groups = {name: 0 if single else pose for name, pose in poses.items()}
    return describe_blurred(statistics.sharpness, groups, "board images" if single else "images of its pose")

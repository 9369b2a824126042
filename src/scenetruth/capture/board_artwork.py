"""Artwork of calibration boards: areas of ink and calibration points of ChArUco boards, checkerboards and dot grids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from scenetruth.errors import ArgumentError, Problem
from scenetruth.validated_model import FrozenModel, Positive
from scenetruth.validation_problems import list_problems

__all__ = [
    "BoardArtwork", "BoardKind", "BoardPrint", "DotPlace", "default_board", "draw_board", "draw_dots", "marker_problem",
    "read_board_print",
]  # fmt: skip

Array = NDArray[np.float64]
BoardKind = Literal["charuco", "checkerboard", "dots", "asymmetric_dots"]
"""Types of boards."""
Count = Annotated[int, Field(ge=2, le=100)]
DotPlace = tuple[Annotated[int, Field(ge=0, le=99)], Annotated[int, Field(ge=0, le=99)]]
"""Column and row of a dot, from 0 at the upper left."""

_CORNERS_OF_DISC = 512
_LARGEST_DOT = 0.8  # largest diameter relative to the distance of neighbouring dots
_HOLE = 1 / 3  # diameter of the hole of a hollow dot relative to the dot


class BoardPrint(FrozenModel):
    """Printed calibration board: its type and its nominal lengths, as in the section ``board`` of a capture file."""

    kind: BoardKind
    """Type of the board."""
    squares: tuple[Count, Count] | None = None
    """Columns and rows of squares of a ``charuco`` or ``checkerboard``."""
    square_mm: Positive | None = None
    """Side of a square in mm."""
    marker_mm: Positive | None = None
    """Side of a marker of a ``charuco`` board in mm."""
    dictionary: Annotated[str, Field(pattern=r"^[A-Z0-9]+(_[A-Z0-9a-z]+)*$", max_length=40)] | None = None
    """ArUco dictionary of a ``charuco`` board, such as ``4X4_250``."""
    legacy: bool = False
    """Pattern of ``charuco`` boards with an even number of rows as before OpenCV 4.6."""
    dots: tuple[Count, Count] | None = None
    """Columns and rows of dots of a ``dots`` or ``asymmetric_dots`` board."""
    spacing_mm: Positive | None = None
    """Distance in mm between the dots of a row; rows of an asymmetric grid have half of it."""
    diameter_mm: Positive | None = None
    """Diameter of the dots in mm."""
    dark: bool = True
    """Dark dots on a bright ground; false for bright dots of a ``dots`` or ``asymmetric_dots`` board."""
    markers: tuple[DotPlace, DotPlace, DotPlace] | None = None
    """Hollow dots (column, row), from 0 at the upper left: one, another in its row, and another in its column. Boards
    with them may be cut off by the image border."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        squared, dotted, charuco = (
            ("squares", "square_mm"),
            ("dots", "spacing_mm", "diameter_mm"),
            ("marker_mm", "dictionary"),
        )
        required = {"charuco": squared + charuco, "checkerboard": squared}.get(self.kind, dotted)
        lacking = [name for name in required if getattr(self, name) is None]
        named = [name for name in (*squared, *charuco, *dotted, "markers") if getattr(self, name) is not None]
        optional = ("markers",) if required == dotted else ()
        extra = [name for name in named if name not in (*required, *optional)]
        extra += ["dark: false"] if not self.dark and required != dotted else []
        problems = [f"lacks {', '.join(lacking)}"] if lacking else []
        problems += [f"must not have {', '.join(extra)}"] if extra else []
        if self.marker_mm is not None and self.square_mm is not None and self.marker_mm >= self.square_mm:
            problems.append(f"has markers of {self.marker_mm:g} mm, which do not fit into squares")
        if self.spacing_mm is not None and self.diameter_mm is not None:
            nearest = self.spacing_mm / (np.sqrt(2) if self.kind == "asymmetric_dots" else 1)
            if self.diameter_mm > _LARGEST_DOT * nearest:
                problems.append(
                    f"has dots of {self.diameter_mm:g} mm, more than 0.8 of their distance of {nearest:g} mm"
                )
        if self.markers is not None and self.dots is not None and required == dotted:
            problem = marker_problem(self.kind, self.dots, self.markers)
            problems += [f"has markers that {problem}"] if problem else []
        if problems:
            msg = f"a board of this type ({self.kind}) {' and '.join(problems)}"
            raise ValueError(msg)
        return self

    def stated(self, mode: Literal["python", "json"] = "python") -> dict[str, Any]:
        """Return the fields that a board of this type has, without dark dots, which are the default."""
        plain = self.model_dump(mode=mode, exclude_none=True)
        if self.kind != "charuco":
            plain.pop("legacy")
        if self.dark:
            plain.pop("dark")
        return plain


def marker_problem(kind: str, dots: tuple[int, int], markers: tuple[DotPlace, DotPlace, DotPlace]) -> str:
    """Return why three dots do not number a grid of dots; empty if they do.

    A column of an asymmetric grid has every second row.
    """
    first, right, below = markers
    if any(place[axis] >= dots[axis] for place in markers for axis in (0, 1)):
        return f"must lie on the grid of {dots[0]} x {dots[1]} dots; got {markers}"
    apart = first[0] != right[0] and first[1] != below[1]
    shifted = kind == "asymmetric_dots" and (first[1] - below[1]) % 2
    if not apart or first[1] != right[1] or first[0] != below[0] or shifted:
        rows = ", an even number of rows away" if kind == "asymmetric_dots" else ""
        return f"must be a dot, another in its row, and another in its column{rows}; got {markers}"
    return ""


# Share of the field of view that a board fills; boards whose points must all be visible fill less.
_FILLED, _FILLED_WHOLE = 0.9, 0.65
_COLUMNS, _LEAST_ROWS = 12, 5


def default_board(kind: BoardKind, field_mm: tuple[float, float], travel_mm: float = 0.0) -> BoardPrint:
    """Return a board with lengths of two digits for a field of view and a travel of the stage along X.

    >>> default_board("charuco", (84.0, 63.0)).square_mm
    6.3
    """
    width, height = field_mm
    rows = max(round(_COLUMNS * height / width), _LEAST_ROWS)
    # A part of a ChArUco board is sufficient.
    free = width if kind == "charuco" else max(width - travel_mm, 0.1 * width)
    filled = _FILLED if kind == "charuco" else _FILLED_WHOLE
    square = float(f"{filled * min(free / _COLUMNS, height / rows):.2g}")
    if kind == "charuco":
        lengths: dict[str, Any] = {"square_mm": square, "marker_mm": 0.75 * square, "dictionary": "4X4_250"}
        return BoardPrint(kind=kind, squares=(_COLUMNS, rows), **lengths)
    if kind == "checkerboard":
        # One even and one odd number of squares make the orientation unique.
        return BoardPrint(kind=kind, squares=(_COLUMNS, rows - 1 + rows % 2), square_mm=square)
    if kind == "dots":
        return BoardPrint(kind=kind, dots=(_COLUMNS, rows), spacing_mm=square, diameter_mm=0.5 * square)
    return BoardPrint(kind=kind, dots=(4, 11), spacing_mm=2 * square, diameter_mm=0.6 * square)


def read_board_print(values: BoardPrint | Mapping[str, Any]) -> BoardPrint:
    """Return a validated board; raises `ArgumentError` with every problem."""
    if isinstance(values, BoardPrint):
        return values
    try:
        return BoardPrint.model_validate(dict(values))
    except ValidationError as error:
        problems = list_problems(error, values, model=BoardPrint, under="board")
        raise ArgumentError(problems, source="a calibration board") from error


@dataclass(frozen=True, eq=False)
class BoardArtwork:
    """Areas of ink and calibration points in the plane of a board, in mm, u to the right and v down.

    The origin of a board with squares is its upper left corner, that of a dot grid the first dot, as in OpenCV.

    ``rings``: Closed polygons of ink, clockwise, in groups of shape (n, corners, 2); they do not overlap. Holes are
      anticlockwise.
    ``points_mm``: Calibration points in the order of OpenCV, shape (n, 2): inner corners, or centres of dots.
    ``box_mm``: Left, upper, right and lower border of the white plate.
    """

    rings: tuple[Array, ...]
    points_mm: Array
    box_mm: tuple[float, float, float, float]

    @property
    def centre_mm(self) -> Array:
        """Centre of the calibration points, the origin of the warp."""
        return np.asarray((self.points_mm.min(axis=0) + self.points_mm.max(axis=0)) / 2)

    @property
    def half_width_mm(self) -> float:
        """Half of the longer side of the calibration points, the unit of length of the warp."""
        return float(np.ptp(self.points_mm, axis=0).max() / 2)

    @property
    def plate(self) -> Array:
        """Outline of the white plate, shape (1, 4, 2)."""
        left, top, right, bottom = self.box_mm
        return np.array([[[left, top], [right, top], [right, bottom], [left, bottom]]])


def draw_board(board: BoardPrint) -> BoardArtwork:
    """Return the artwork of a board; a ``charuco`` board requires OpenCV for its markers.

    >>> artwork = draw_board(BoardPrint(kind="checkerboard", squares=(4, 3), square_mm=5))
    >>> artwork.points_mm[:3].tolist(), len(artwork.rings[0])
    ([[5.0, 5.0], [10.0, 5.0], [15.0, 5.0]], 6)
    """
    if board.squares is not None and board.square_mm is not None:
        return _draw_squares(board, board.squares, board.square_mm)
    assert board.dots is not None  # ensured by the validator
    assert board.spacing_mm is not None
    assert board.diameter_mm is not None
    columns, rows = board.dots
    row, column = np.mgrid[:rows, :columns].astype(np.float64)
    if board.kind == "asymmetric_dots":
        # The order of OpenCV: row by row; odd rows are shifted by half the distance in a row.
        column, row = column + 0.5 * (row % 2), row / 2
    points = board.spacing_mm * np.stack([column, row], axis=-1).reshape(-1, 2)
    hollow = [row * columns + column for column, row in board.markers or ()]
    artwork = draw_dots(points, board.diameter_mm, board.spacing_mm, hollow)
    if board.dark:
        return artwork
    # The ground is ink, and the dots are free of it.
    return replace(artwork, rings=(artwork.plate, *(ring[:, ::-1] for ring in artwork.rings)))


def draw_dots(points_mm: Array, diameter_mm: float, margin_mm: float, hollow: Sequence[int] = ()) -> BoardArtwork:
    """Return the artwork of dots at given centres, shape (n, 2), on a plate with a margin around the centres.

    ``hollow``: Indices of dots with a hole, whose outline is anticlockwise.
    """
    angle = 2 * np.pi * np.arange(_CORNERS_OF_DISC) / _CORNERS_OF_DISC
    # The polygon has the area of the disc.
    radius = diameter_mm / 2 * np.sqrt(2 * np.pi / (_CORNERS_OF_DISC * np.sin(2 * np.pi / _CORNERS_OF_DISC)))
    outline = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    low, high = points_mm.min(axis=0) - margin_mm, points_mm.max(axis=0) + margin_mm
    rings = [points_mm[:, None] + outline]
    if len(hollow):
        rings.append(points_mm[list(hollow), None] + _HOLE * outline[::-1])
    return BoardArtwork(tuple(rings), points_mm, (*low.tolist(), *high.tolist()))


def _draw_squares(board: BoardPrint, squares: tuple[int, int], side: float) -> BoardArtwork:
    """Return the artwork of a checkerboard, with markers in its white squares if it is a ChArUco board."""
    columns, rows = squares
    row, column = np.mgrid[:rows, :columns]
    # The first square is black, except in legacy patterns with an even number of rows.
    black = (row + column) % 2 == (1 if board.legacy and board.kind == "charuco" and rows % 2 == 0 else 0)
    rings = [_squares_at(side * np.stack([column[black], row[black]], axis=-1), side)]
    row, column = np.mgrid[1:rows, 1:columns]
    points = side * np.stack([column, row], axis=-1).reshape(-1, 2).astype(np.float64)
    if board.kind == "charuco":
        rings.append(_draw_markers(board, squares, side))
    # The margin is as wide as a square.
    box = (-side, -side, (columns + 1) * side, (rows + 1) * side)
    return BoardArtwork(tuple(rings), points, box)


def _squares_at(corners_mm: Array, side: float) -> Array:
    """Return squares with given upper left corners, clockwise with v down, shape (n, 4, 2)."""
    outline = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(np.asarray(corners_mm, dtype=np.float64)[:, None] + outline)


def _draw_markers(board: BoardPrint, squares: tuple[int, int], side: float) -> Array:
    """Return the black cells of all markers; edges that two cells share cancel."""
    try:
        from cv2 import aruco
    except ImportError as error:
        message = f"requires OpenCV, which cannot be imported ({error}); install it: pip install 'scenetruth[opencv]'"
        raise ArgumentError([Problem("board.kind", message, board.kind)], source="a calibration board") from error
    name = f"DICT_{board.dictionary}"
    if not hasattr(aruco, name):
        names = sorted(key.removeprefix("DICT_") for key in dir(aruco) if key.startswith("DICT_"))
        message = f"must be a dictionary of OpenCV: {', '.join(names)}"
        raise ArgumentError([Problem("board.dictionary", message, board.dictionary)], source="a calibration board")
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
    needed, present = (squares[0] * squares[1]) // 2, len(dictionary.bytesList)
    if needed > present:
        message = f"has {present} markers, but the board needs {needed}; choose a larger dictionary or fewer squares"
        raise ArgumentError([Problem("board.dictionary", message, board.dictionary)], source="a calibration board")
    marker = float(board.marker_mm or 0.0)
    layout = aruco.CharucoBoard(squares, side, marker, dictionary)
    layout.setLegacyPattern(board.legacy)
    bits = int(dictionary.markerSize) + 2
    cells = []
    for number, corners in zip(np.asarray(layout.getIds()).ravel().tolist(), layout.getObjPoints(), strict=True):
        ink = aruco.generateImageMarker(dictionary, number, bits) == 0
        row, column = np.nonzero(ink)
        # OpenCV stores lengths in float32; the square follows from the centre of the marker.
        start = side * np.floor(np.mean(corners, axis=0)[:2] / side) + (side - marker) / 2
        cells.append(_squares_at(start + marker / bits * np.stack([column, row], axis=-1), marker / bits))
    return np.concatenate(cells)

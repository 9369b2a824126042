"""Calibration boards to print at true scale: ChArUco boards, checkerboards and grids of dots."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from scenetruth.capture import BoardArtwork, BoardKind, BoardPrint, default_board, draw_board, read_board_print
from scenetruth.design.patterns.generation import Pattern
from scenetruth.design.patterns.page_layout import lay_out_pages
from scenetruth.design.patterns.pattern_model import Array, Box, InkAreas, InkDots, PatternDrawing, PatternModel
from scenetruth.design.patterns.pattern_rig import PatternRig
from scenetruth.design.patterns.printing import render_svg, write_pdf, write_texture_image
from scenetruth.errors import ArgumentError, Problem

__all__ = ["BoardPattern", "export_board", "generate_board"]

BOARD_SIGN = "board.yaml"
"""Name of the file that identifies a directory of a board."""
BOARD_FILES = ("board.pdf", "board.svg", "board.png")
"""Names of the other files of a board."""

_PRINTED_STD = 1e-3


class BoardPattern(PatternModel):
    """Calibration board as a pattern."""

    kind: BoardKind
    """Type of the board."""
    board: BoardPrint
    """The board with its lengths."""

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> PatternDrawing:
        """Draw the board; see `PatternModel`."""
        plain = self.board.dark and self.board.markers is None
        return _BoardInk(draw_board(self.board), self.board.diameter_mm if plain else None)

    def description(self, mm_per_px: float) -> str:
        """Return a one-line description; see `PatternModel`."""
        board = self.board
        if board.squares is not None:
            return (
                f"{board.squares[0]} x {board.squares[1]} squares of {board.square_mm:g} mm "
                f"({self.finest_mm / mm_per_px:.1f} px)"
                + (f", markers of {board.marker_mm:g} mm, dictionary {board.dictionary}" if board.marker_mm else "")
            )
        assert board.dots is not None  # ensured by the validator
        return (
            f"{board.dots[0]} x {board.dots[1]} dots of {board.diameter_mm:g} mm "
            f"({self.finest_mm / mm_per_px:.1f} px), {board.spacing_mm:g} mm apart in a row"
        )

    @property
    def finest_mm(self) -> float:
        """Side of a square, or diameter of a dot, in mm."""
        return float(self.board.square_mm or self.board.diameter_mm or 0.0)

    @property
    def coarsest_mm(self) -> float:
        """Side of a square, or distance of dots, in mm."""
        return float(self.board.square_mm or self.board.spacing_mm or 0.0)


@dataclass(frozen=True, eq=False)
class _BoardInk(PatternDrawing):
    """Ink of a board; the origin of the pattern is the upper left corner of its plate."""

    artwork: BoardArtwork
    dot_mm: float | None

    @property
    def _origin(self) -> Array:
        return np.array(self.artwork.box_mm[:2])

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        from scenetruth.capture.coverage_kernels import add_edges

        left, top, width, height = box_mm
        scale = np.array([shape[1] / width, shape[0] / height])
        area = np.zeros((shape[0], shape[1] + 1))
        for rings in self.artwork.rings:
            corners = (rings - self._origin - (left, top)) * scale
            add_edges(corners.reshape(-1, 2), np.roll(corners, -1, axis=1).reshape(-1, 2), area)
        return np.cumsum(area, axis=1)[:, :-1].astype(np.float32)

    def marks(self, box_mm: Box) -> InkAreas | InkDots:
        if self.dot_mm is not None:
            return InkDots(self.artwork.points_mm - self._origin, self.dot_mm)
        return InkAreas([ring - self._origin for rings in self.artwork.rings for ring in rings])


def generate_board(rig: PatternRig, type: BoardKind = "charuco", **lengths: Any) -> Pattern:
    """Generate a calibration board for a rig.

    Parameters
    ----------
    rig
        The rig. Without lengths, the board fills its field of view; boards whose points must all be visible fill 65 %
        of the width that all positions have in common.
    type
        ``"charuco"``, ``"checkerboard"``, ``"dots"`` or ``"asymmetric_dots"``.
    **lengths
        Numbers and lengths of the board, as in the section ``board`` of a capture file: all that the type requires, or
        none.

    Returns
    -------
    Pattern
        The board as a pattern, of the size of its white plate.

    Raises
    ------
    ArgumentError
        If lengths are invalid, or are missing although the rig has no image size.

    See Also
    --------
    scenetruth.design.patterns.export_board : Exports the board for printing.

    Examples
    --------
    >>> from scenetruth.design.patterns import PatternRig, generate_board
    >>> rig = PatternRig.from_scene(focal_length_px=5016, distance_mm=660, image_size_px=(640, 480))
    >>> generate_board(rig, "checkerboard").description
    '12 x 9 squares of 4.6 mm (35.0 px)'
    >>> generate_board(rig, "dots", dots=(11, 8), spacing_mm=6, diameter_mm=3).size_mm
    (72.0, 54.0)
    """
    if not lengths:
        field = rig.field_mm
        if field is None:
            message = "are missing, and the rig has no image size from which they follow; specify them"
            raise ArgumentError([Problem("lengths of the board", message)], source="a calibration board")
        travel = (rig.baseline_mm or 0.0) * (rig.positions - 1)
        board = default_board(type, (float(field[0]), float(field[1])), abs(travel))
    else:
        board = read_board_print({"kind": type, **lengths})
    model = BoardPattern(kind=board.kind, board=board)
    drawing = model.draw((0.0, 0.0), np.random.default_rng(0))
    left, top, right, bottom = draw_board(board).box_mm
    return Pattern(model, (right - left, bottom - top), 0, rig, drawing)


def export_board(pattern: Pattern, folder: str | Path, *, page: str = "A4", margin_mm: float = 10.0) -> list[Path]:
    """Write a board to an existing folder, to be printed on a single page at true scale.

    Parameters
    ----------
    pattern
        The board, from `generate_board`.
    folder
        The output folder.
    page, margin_mm
        Page size and margin, as in `scenetruth.design.patterns.page_layout.lay_out_pages`.

    Returns
    -------
    list of pathlib.Path
        ``board.pdf`` and ``board.svg``, the page; ``board.png``, the board as an image texture; and ``board.yaml``,
        the section ``board`` of a capture file.

    Raises
    ------
    ArgumentError
        If the page size is unknown, or the page does not hold the whole board.

    See Also
    --------
    scenetruth.design.patterns.generate_board : Generates a board.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.design.patterns import PatternRig, export_board, generate_board
    >>> rig = PatternRig.from_scene(focal_length_px=5016, distance_mm=660, image_size_px=(640, 480))
    >>> with TemporaryDirectory() as folder:
    ...     files = export_board(generate_board(rig, "checkerboard"), folder)
    ...     print(*(file.name for file in files))
    board.pdf board.svg board.png board.yaml
    """
    pages = lay_out_pages(pattern, page, margin_mm)
    if len(pages) > 1:
        width, height = pattern.size_mm
        message = f"does not hold the board of {width:g} x {height:g} mm; choose a larger page or a smaller board"
        raise ArgumentError([Problem("page", message, page)], source="a calibration board")
    place = Path(folder)
    pdf, svg, png = (place / name for name in BOARD_FILES)
    write_pdf(pdf, pattern, pages)
    svg.write_text(render_svg(pattern, pages[0]), encoding="utf-8")
    write_texture_image(png, pattern)
    sign = place / BOARD_SIGN
    sign.write_text(format_board(pattern), encoding="utf-8")
    return [pdf, svg, png, sign]


def format_board(pattern: Pattern) -> str:
    """Return a board as the section of a capture file, with the tolerance of a print."""
    assert isinstance(pattern.model, BoardPattern)  # from generate_board
    board = pattern.model.board.model_dump(mode="json", exclude_none=True)
    if board["kind"] != "charuco":
        del board["legacy"]
    text: str = yaml.safe_dump({"board": {**board, "scale_std": _PRINTED_STD}}, sort_keys=False, width=100)
    return (
        f"# scenetruth {version('scenetruth')}: {pattern.description}\n"
        "# Measure the print: correct the lengths, and set scale_std to the relative uncertainty of the measurement.\n"
        f"{text}"
    )

"""Layout of a pattern on pages at true scale: tiles, crop marks, rulers, labels."""

from __future__ import annotations

import math
import re
import textwrap
from dataclasses import dataclass
from importlib.metadata import version

from scenetruth.design.patterns.generation import Pattern
from scenetruth.design.patterns.pattern_model import Box
from scenetruth.errors import ArgumentError, Problem

__all__ = ["PageLine", "PageText", "PrintPage", "lay_out_pages"]

PAGES_MM = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
}
"""Width and height of pages in portrait orientation (ISO 216)."""

RULER_MM = 100
"""Length of the rulers in mm."""

# Space around a tile for crop marks, for a ruler, and the least size of a tile.
_CROP_MM, _RULER_SPACE_MM, _LEAST_TILE_MM = 5.0, 9.0, 20.0
_GAP_MM = 1.0
_TEXT_MM, _LINE_MM = 2.6, 3.6
_LETTER = 0.58  # mean width of a letter relative to the font size of a sans-serif font, rounded up
_HAIR_MM, _THIN_MM = 0.1, 0.2
_MOST_PAGES = 400


@dataclass(frozen=True)
class PageLine:
    """A straight line on a page, in mm from the upper left corner."""

    x0: float
    y0: float
    x1: float
    y1: float
    width: float


@dataclass(frozen=True)
class PageText:
    """A line of text; ``anchor`` is its alignment at (x, y) on the baseline; ``upright`` text reads upwards."""

    x: float
    y: float
    content: str
    size: float
    anchor: str = "start"
    upright: bool = False


@dataclass(frozen=True)
class PrintPage:
    """A page to print: size, positions of the tile on the page and in the pattern, crop marks, rulers and labels."""

    size_mm: tuple[float, float]
    place_mm: Box
    tile_mm: Box
    lines: tuple[PageLine, ...]
    texts: tuple[PageText, ...]


def lay_out_pages(pattern: Pattern, page: str = "A4", margin_mm: float = 10.0) -> list[PrintPage]:
    """Lay out a pattern on pages of a named size, in either orientation, or of WIDTHxHEIGHT in mm."""
    sizes = _page_sizes(page)
    problems = [] if sizes else [Problem("page", f"must be one of {', '.join(PAGES_MM)}, or WIDTHxHEIGHT in mm", page)]
    if not 0 <= margin_mm <= 100:
        problems.append(Problem("margin_mm", "must be from 0 to 100 mm", margin_mm))
    if problems:
        raise ArgumentError(problems, source="a pattern")
    values = _compose_label(pattern)
    laid = [(size, _compute_tile_area(size, margin_mm, values)) for size in sizes]
    laid = [(size, room) for size, room in laid if min(room[2:]) >= _LEAST_TILE_MM]
    if not laid:
        message = f"leaves less than {_LEAST_TILE_MM:g} mm for the pattern within its margins; choose a larger page"
        raise ArgumentError([Problem("page", message, page)], source="a pattern")
    size, room = min(laid, key=lambda each: math.prod(_tiles(pattern.size_mm, each[1])))
    columns, rows = _tiles(pattern.size_mm, room)
    if columns * rows > _MOST_PAGES:
        message = f"takes {columns * rows:,} pages, more than {_MOST_PAGES}; choose larger pages or a smaller pattern"
        raise ArgumentError([Problem("page", message, page)], source="a pattern")
    return [
        _page(pattern, size, room, (row, column), (rows, columns), margin_mm, values)
        for row in range(rows)
        for column in range(columns)
    ]


def _page_sizes(page: str) -> list[tuple[float, float]]:
    known = {name.casefold(): size for name, size in PAGES_MM.items()}
    if page.casefold() in known:
        width, height = known[page.casefold()]
        return [(width, height), (height, width)]
    found = re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", page.strip().casefold())
    size = (float(found[1]), float(found[2])) if found else (0.0, 0.0)
    return [size] if all(20 <= side <= 5000 for side in size) else []


def _compose_label(pattern: Pattern) -> list[str]:
    rig = pattern.rig
    width, height = pattern.size_mm
    return [
        f"scenetruth {version('scenetruth')}, {pattern.model.kind} pattern of {width:g} x {height:g} mm, "
        f"seed {pattern.seed}: "
        f"{pattern.description}. For a focal length of {rig.focal_length_px:g} px at {rig.distance_mm:g} mm: "
        f"1 px is {rig.mm_per_px:.4g} mm.",
        "Print at 100 % (actual size; do not fit to the page), and check both rulers.",
    ]


def _wrapped(caption: list[str], width_mm: float) -> list[str]:
    letters = max(int(width_mm / (_LETTER * _TEXT_MM)), 20)
    return [line for each in caption for line in textwrap.wrap(each, letters)]


def _compute_tile_area(size: tuple[float, float], margin_mm: float, caption: list[str]) -> Box:
    """Return the largest tile on a page."""
    left, top = margin_mm + _RULER_SPACE_MM + _CROP_MM, margin_mm + _CROP_MM
    # One additional line for the page number.
    text = _LINE_MM * (len(_wrapped(caption, size[0] - 2 * margin_mm)) + 1)
    below = _CROP_MM + _RULER_SPACE_MM + text
    return left, top, size[0] - left - margin_mm - _CROP_MM, size[1] - top - margin_mm - below


def _tiles(size_mm: tuple[float, float], room: Box) -> tuple[int, int]:
    """Return the number of columns and rows of tiles."""
    columns, rows = (max(math.ceil(side / most - 1e-9), 1) for side, most in zip(size_mm, room[2:], strict=True))
    return columns, rows


def _page(
    pattern: Pattern,
    size: tuple[float, float],
    room: Box,
    which: tuple[int, int],
    of: tuple[int, int],
    margin_mm: float,
    caption: list[str],
) -> PrintPage:
    (row, column), (rows, columns) = which, of
    left, top, most_width, most_height = room
    x, y = column * most_width, row * most_height
    width, height = min(most_width, pattern.size_mm[0] - x), min(most_height, pattern.size_mm[1] - y)
    lines, texts = _crop_marks((left, top, width, height)), []
    for upright in (False, True):
        more, numbers = _ruler(room, upright=upright)
        lines += more
        texts += numbers
    number = row * columns + column + 1
    where = f"Page {number} of {rows * columns}"
    if rows * columns > 1:
        where += f": row {row + 1} of {rows}, column {column + 1} of {columns}; cut along the crop marks"
    first = top + most_height + _CROP_MM + _RULER_SPACE_MM + _LINE_MM - 0.6
    for n, line in enumerate([*_wrapped(caption, size[0] - 2 * margin_mm), where + "."]):
        texts.append(PageText(margin_mm, first + n * _LINE_MM, line, _TEXT_MM))
    return PrintPage(size, (left, top, width, height), (x, y, width, height), tuple(lines), tuple(texts))


def _crop_marks(place: Box) -> list[PageLine]:
    left, top, width, height = place
    found = []
    for x, outward in ((left, -1), (left + width, 1)):
        for y, down in ((top, -1), (top + height, 1)):
            near, far = _GAP_MM, _CROP_MM - 0.5
            found.append(PageLine(x + outward * near, y, x + outward * far, y, _HAIR_MM))
            found.append(PageLine(x, y + down * near, x, y + down * far, _HAIR_MM))
    return found


def _ruler(room: Box, *, upright: bool) -> tuple[list[PageLine], list[PageText]]:
    """Return a ruler below the tile, or an upright ruler to its left, with a tick for every mm."""
    left, top, width, height = room
    length = min(RULER_MM, int((height if upright else width) // 10) * 10)
    # Ticks point away from the tile.
    line = (left if upright else top + height) + (-1 if upright else 1) * (_CROP_MM + 0.5)
    start = top + height if upright else left

    def at(along: float, away: float) -> tuple[float, float]:
        return (line - away, start - along) if upright else (start + along, line + away)

    lines = [PageLine(*at(0, 0), *at(length, 0), _THIN_MM)]
    texts = []
    for mm in range(length + 1):
        tick = 3.0 if mm % 10 == 0 else 2.2 if mm % 5 == 0 else 1.4
        lines.append(PageLine(*at(mm, 0), *at(mm, tick), _HAIR_MM))
        if mm % 10 == 0:
            words = f"{mm} mm" if mm == length else str(mm)
            texts.append(PageText(*at(mm, 3.6 if upright else 5.6), words, 2.2, "middle", upright))
    return lines, texts

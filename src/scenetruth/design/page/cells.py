"""Tables of a page: cells that sort by their number, whatever they say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scenetruth.design.page.scene_file import SceneFile
from scenetruth.design.page.words import number

__all__ = ["Cell", "Table", "number_cell"]


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text
        What it says.
    key
        The number by which it sorts; None to sort by what it says.
    file
        A scene file that it hands over.
    """

    text: str
    key: float | None = None
    file: SceneFile | None = None


@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    name
        Its name within the page.
    caption
        What it shows.
    columns
        Heads.
    lines
        Its lines.
    marked
        Number of the line that stands out; None if none does.
    """

    name: str
    caption: str
    columns: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    marked: int | None = None

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers."""
        return [any(line[place].key is not None for line in self.lines) for place in range(len(self.columns))]


def number_cell(value: float | None, unit: str = "") -> Cell:
    """Return a cell with a number."""
    if value is None or not math.isfinite(value):
        return Cell(number(value))
    return Cell(f"{number(value)} {unit}".rstrip(), float(value))

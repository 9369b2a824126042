"""Tables of a page: cells that sort by their number, whatever they say."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Cell", "Table", "key_of", "table_of"]

_NONE = "–"
_NUMBER = re.compile(r"[-+]?(∞|\d+(\.\d*)?([eE][-+]?\d+)?)(?!\w)")


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text
        What it says.
    key
        The number by which it sorts; None to sort by what it says.
    address, saved_as
        Address of a file that it hands over, and what that is called when it is saved; empty if there is none.
    """

    text: str
    key: float | None = None
    address: str = ""
    saved_as: str = ""

    @property
    def sorts_by(self) -> str:
        """The key, as JavaScript reads it; empty if there is none."""
        if self.key is None or math.isnan(self.key):
            return ""
        return repr(float(self.key)).replace("inf", "Infinity")


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
    foot
        Lines that stay below the others, such as sums.
    """

    name: str
    caption: str
    columns: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    marked: int | None = None
    foot: Sequence[Sequence[Cell]] = ()

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers, or dashes where there are none."""
        columns = [[line[place] for line in self.lines] for place in range(len(self.columns))]
        return [
            any(cell.key is not None for cell in cells) or (bool(cells) and all(cell.text == _NONE for cell in cells))
            for cells in columns
        ]


def table_of(name: str, caption: str, columns: Sequence[str], lines: Iterable[Iterable[Any]]) -> Table:
    """Return a table of texts; those that begin with a number sort by it.

    Parameters
    ----------
    name, caption, columns
        As of `Table`.
    lines
        What cells say.
    """
    cells = [[Cell(str(text), key_of(str(text))) for text in line] for line in lines]
    return Table(name, caption, columns, cells)


def key_of(text: str) -> float | None:
    """Return the number that a text begins with; None if it begins with none.

    Examples
    --------
    >>> [key_of(text) for text in ("0.5", "-3 px", "1e-3 to 2", "−2", "∞", "leaf", "–", "3d")]
    [0.5, -3.0, 0.001, -2.0, inf, None, None, None]
    """
    found = _NUMBER.match(text.strip().replace("\N{MINUS SIGN}", "-"))
    return None if found is None else float(found[0].replace("∞", "inf"))

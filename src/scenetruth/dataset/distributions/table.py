"""Values from a column of a table."""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from scenetruth.dataset.distributions.base import ByNumber
from scenetruth.errors import Problem
from scenetruth.files import InputFile, size_of_file
from scenetruth.model import Name

__all__ = ["Table"]

_MOST_BYTES = 100_000_000


class Table(ByNumber):
    """The values of one column of a CSV file with a line of headings: sample n has those of the n-th line.

    Fields that name the same file move through it together. After the last line comes the first again.
    """

    kind: Literal["table"] = "table"
    file: InputFile
    """The CSV file; a relative path counts from the recipe's folder."""
    column: Name
    """Heading of the column."""

    def __len__(self) -> int:
        """Return how many lines there are."""
        return len(self._values())

    def value(self, place: int) -> Any:
        """Return the value in a line: a number where it reads as one."""
        return self._values()[place]

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value, with its line."""
        return [(f"column (line {line})", value) for line, value in enumerate(self._values(), start=2)]

    def problems(self) -> list[Problem]:
        """Return why the file or its column cannot be used."""
        try:
            if size_of_file(Path(self.file)) > _MOST_BYTES:
                return [Problem("file", f"has more than {_MOST_BYTES:,} bytes", self.file)]
            columns = _columns_of(self.file)
        except (OSError, ValueError, csv.Error) as error:
            told = getattr(error, "strerror", None) or error
            return [Problem("file", f"cannot be read: {told}", self.file)]
        if self.column not in columns:
            return [Problem("column", f"is not in the table; its columns are {', '.join(columns)}", self.column)]
        if not columns[self.column]:
            return [Problem("file", "has no lines below its headings", self.file)]
        return []

    def _values(self) -> tuple[Any, ...]:
        return _columns_of(self.file)[self.column]


@lru_cache(maxsize=16)
def _columns_of(file: str) -> dict[str, tuple[Any, ...]]:
    with Path(file).open(newline="", encoding="utf-8-sig") as stream:
        lines = [line for line in csv.reader(stream, strict=True) if line]
    if not lines:
        msg = "is empty"
        raise ValueError(msg)
    headings = [heading.strip() for heading in lines[0]]
    wrong = next((number for number, line in enumerate(lines, start=1) if len(line) != len(headings)), None)
    if wrong is not None:
        msg = f"line {wrong} has {len(lines[wrong - 1])} values for {len(headings)} headings"
        raise ValueError(msg)
    return {heading: tuple(_read(line[place]) for line in lines[1:]) for place, heading in enumerate(headings)}


def _read(text: str) -> Any:
    text = text.strip()
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)

"""Angular distribution of the light of a lamp, from photometric files (IESNA LM-63)."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import describe_missing, regular_file_size

__all__ = ["LightDistribution", "load_distribution"]

_MAX_BYTES = 20_000_000
_MOST_ANGLES = 10_000  # vertical or horizontal
_HEADER = 13  # numbers before the angles
_LEAST_STEP = 1e-6  # degrees between angles
_MOST_SHOWN = 5  # numbers with the same problem
_WHOLE = 360.0


@dataclass(frozen=True, eq=False)
class LightDistribution:
    """Intensity by direction, relative to its maximum; bilinear between the angles.

    ``vertical_deg``: Angles from the axis of the lamp, ascending, shape (n,); outside, there is no light.
    ``horizontal_deg``: Angles around the axis, ascending from 0 to 360, shape (m,).
    ``relative``: Shape (m, n).
    """

    vertical_deg: NDArray[np.float64]
    horizontal_deg: NDArray[np.float64]
    relative: NDArray[np.float64]

    def at(self, vertical_deg: NDArray[np.float64], horizontal_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the relative intensity in directions, shape (n,)."""
        row, down = _place(self.horizontal_deg, horizontal_deg % _WHOLE)
        column, right = _place(self.vertical_deg, vertical_deg)
        first, second = (
            (1 - right) * self.relative[rows, column] + right * self.relative[rows, column + 1]
            for rows in (row, row + 1)
        )
        inside = (vertical_deg >= self.vertical_deg[0]) & (vertical_deg <= self.vertical_deg[-1])
        return np.where(inside, (1 - down) * first + down * second, 0.0)


def _place(
    nodes: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:  # fmt: skip
    """Return the interval of each value, and its position there from 0 to 1."""
    index = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, len(nodes) - 2)
    return index, np.clip((values - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)


def load_distribution(file: Path) -> LightDistribution:
    """Read an IES file; raises a SceneError with every problem at the path ``file``.

    IESNA LM-63 of 1986, 1991, 1995, 2002 and 2019, with photometry of type C and ``TILT=NONE``.
    """
    try:
        size = regular_file_size(file)
        if size > _MAX_BYTES:
            message = f"has {size:,} bytes, more than {_MAX_BYTES:,}: it is not an IES file"
            raise SceneError([Problem("file", message, str(file))])
        return _parse(file.name, file.read_bytes())
    except FileNotFoundError as error:
        raise SceneError([Problem("file", describe_missing(file, "no such IES file"), str(file))]) from error
    except (OSError, ValueError) as error:
        raise SceneError([Problem("file", f"cannot be read: {error}", str(file))]) from error


@lru_cache(maxsize=16)
def _parse(name: str, content: bytes) -> LightDistribution:
    return _Reader(name, content).read()


class _Reader:
    """Reader of one file, which collects problems."""

    def __init__(self, name: str, content: bytes) -> None:
        self._name = name
        self._lines = re.split(r"\r\n|\n|\r", content.decode("latin-1"))
        self._problems: list[Problem] = []
        self._numbers = np.empty(0)
        self._line_of: list[int] = []

    def read(self) -> LightDistribution:
        """Return the content."""
        self._read_numbers(self._first_line())
        vertical, horizontal = self._counts()
        begin, middle = _HEADER + vertical, _HEADER + vertical + horizontal
        self._check_vertical(_HEADER, begin)
        self._check_horizontal(begin, middle)
        self._check_intensity(middle)
        self._stop()
        angles, intensity = self._numbers[begin:middle], self._numbers[middle:].reshape(horizontal, vertical)
        around, rows = _all_round(angles, intensity)
        return LightDistribution(self._numbers[_HEADER:begin], around, rows / rows.max())

    def _add(self, line: int, message: str, value: object) -> None:
        """Add a problem; ``line``: from 0, -1 for none."""
        place = f"{self._name}: " if line < 0 else f"{self._name}, line {line + 1}: "
        self._problems.append(Problem("file", place + message, value))

    def _add_by_line(self, wrong: list[tuple[int, object]], message: str) -> None:
        """Add a problem of several numbers, given as line and value: one for each line, with its first value."""
        by_line: dict[int, list[object]] = {}
        for line, value in wrong:
            by_line.setdefault(line, []).append(value)
        for line, values in itertools.islice(by_line.items(), _MOST_SHOWN):
            more = f", {len(values)} numbers" if len(values) > 1 else ""
            self._add(line, message + more, values[0])

    def _stop(self) -> None:
        """Raise an error if there are problems."""
        if self._problems:
            raise SceneError(self._problems)

    def _first_line(self) -> int:
        """Return the line after TILT."""
        for number, line in enumerate(self._lines):
            key, equals, value = line.partition("=")
            if key.strip().upper() != "TILT" or not equals:
                continue
            if value.strip().upper() != "NONE":
                message = "lamps whose light changes with their tilt are not supported; "
                message += "export the file with TILT=NONE"
                self._add(number, message, line.strip())
                self._stop()
            return number + 1
        message = "is not an IES file: it has no line TILT=NONE; use a photometric file of IESNA LM-63"
        self._add(-1, message, self._lines[0])
        self._stop()
        raise AssertionError

    def _read_numbers(self, first: int) -> None:
        """Read all numbers from a line on."""
        values, wrong = [], list[tuple[int, object]]()
        for number, line in enumerate(self._lines[first:], first):
            for word in line.replace(",", " ").split():
                try:
                    value = float(word) if "_" not in word else np.nan
                except ValueError:
                    value = np.nan
                if not np.isfinite(value):
                    wrong.append((number, word))
                values.append(value)
                self._line_of.append(number)
        self._numbers = np.array(values)
        self._add_by_line(wrong, "must be a finite number")
        self._stop()

    def _counts(self) -> tuple[int, int]:
        """Return the numbers of vertical and horizontal angles, after checks of the numbers before the angles."""
        numbers = self._numbers
        if len(numbers) < _HEADER:
            message = f"ends after {len(numbers)} of the {_HEADER} numbers that precede the angles; export it again"
            self._add(-1, message, None)
            self._stop()
        for place, name, least in ((3, "vertical", 2), (4, "horizontal", 1)):
            value = numbers[place]
            if value != int(value) or not least <= value <= _MOST_ANGLES:
                message = f"the number of {name} angles must be a whole number from {least} to {_MOST_ANGLES:,}"
                self._add(self._line_of[place], message, float(value))
        if not numbers[2] > 0:
            self._add(self._line_of[2], "the multiplier of the intensities must be positive", float(numbers[2]))
        if numbers[5] != 1:
            message = "photometry of type A (3) or B (2) is not supported; convert it to type C (1)"
            self._add(self._line_of[5], message, float(numbers[5]))
        self._stop()
        vertical, horizontal = int(numbers[3]), int(numbers[4])
        given, needed = len(numbers) - _HEADER, vertical + horizontal + vertical * horizontal
        if given != needed:
            message = f"has {given:,} numbers after the header, but {vertical} vertical and {horizontal} horizontal "
            message += f"angles and their intensities are {needed:,}; export it again"
            self._add(self._line_of[3], message, None)
            self._stop()
        return vertical, horizontal

    def _at(self, place: int) -> tuple[int, object]:
        """Return line and value of a number."""
        return self._line_of[place], float(self._numbers[place])

    def _check_ascending(self, begin: int, end: int, name: str) -> None:
        falling = np.flatnonzero(np.diff(self._numbers[begin:end]) <= _LEAST_STEP) + begin + 1
        self._add_by_line([self._at(place) for place in falling.tolist()], f"{name} angles must ascend")

    def _check_vertical(self, begin: int, end: int) -> None:
        self._check_ascending(begin, end, "vertical")
        first, last = self._numbers[begin], self._numbers[end - 1]
        if first not in (0, 90):
            self._add(self._line_of[begin], "the first vertical angle must be 0 or 90°", float(first))
        if last not in (90, 180):
            self._add(self._line_of[end - 1], "the last vertical angle must be 90 or 180°", float(last))

    def _check_horizontal(self, begin: int, end: int) -> None:
        self._check_ascending(begin, end, "horizontal")
        first, last = self._numbers[begin], self._numbers[end - 1]
        if first != 0:
            message = "the first horizontal angle must be 0; turn the lamp by `zero_direction` instead"
            self._add(self._line_of[begin], message, float(first))
        elif last not in (0, 90) and not 180 <= last <= _WHOLE:
            message = "the last horizontal angle must be 0 (equal all round), 90 or 180° (symmetric), or up to 360°"
            self._add(self._line_of[end - 1], message, float(last))

    def _check_intensity(self, begin: int) -> None:
        negative = np.flatnonzero(self._numbers[begin:] < 0) + begin
        self._add_by_line([self._at(place) for place in negative.tolist()], "intensities must not be negative")
        if not self._numbers[begin:].any():
            self._add(self._line_of[begin], "all intensities are 0: the lamp gives no light; use another file", None)


def _all_round(
    angles: NDArray[np.float64], rows: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return horizontal angles from 0 to 360° and their rows, by the symmetry that the last angle states."""
    if len(angles) == 1:
        return np.array([0.0, _WHOLE]), np.concatenate([rows, rows])
    for half in (90.0, 180.0):
        if angles[-1] == half:
            angles = np.concatenate([angles, 2 * half - angles[-2::-1]])
            rows = np.concatenate([rows, rows[-2::-1]])
    if angles[-1] < _WHOLE:
        angles, rows = np.append(angles, _WHOLE), np.concatenate([rows, rows[:1]])
    return angles, rows

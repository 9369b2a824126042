"""Distributions: the rules that draw the values of a varied field."""

from __future__ import annotations

import csv
import math
import os
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from scenetruth.dataset.expression import Expression
from scenetruth.errors import Problem
from scenetruth.input_files import InputFile, regular_file_size
from scenetruth.number_format import format_two_digits
from scenetruth.validated_model import Direction, Finite, FrozenModel, Name, NonNegative, Positive

__all__ = [
    "ChoiceDistribution",
    "ConeDistribution",
    "DerivedDistribution",
    "Distribution",
    "FormulaDistribution",
    "GridDistribution",
    "IndexedDistribution",
    "IntegersDistribution",
    "LinkedDistribution",
    "LogUniformDistribution",
    "NormalDistribution",
    "RandomDistribution",
    "RangeDistribution",
    "RotationDistribution",
    "SamplingPlan",
    "SequenceDistribution",
    "TableDistribution",
    "UniformDistribution",
]


SamplingPlan = Literal["independent", "sobol", "latin_hypercube"]
ValueName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=80)]
"""Name of a value, as formulas write it: letters, digits and underscores."""


class Distribution(FrozenModel):
    """Distribution of a varied field over the samples."""

    name: ValueName | None = None
    """Name of the value in formulas; the fields of ``values`` are named already."""
    together: bool = False
    """Whether all fields matched by a path with wildcards share one value; otherwise each has its own."""

    def trials(self) -> list[tuple[str, Any]]:
        """Return (field, value) pairs that cover the distribution: the limits of a range or every choice."""
        raise NotImplementedError

    def problems(self) -> list[Problem]:
        """Return problems that involve more than one field or a file, such as an unreadable table."""
        return []

    @property
    def is_number(self) -> bool:
        """Whether every value is a number and fits a numeric column."""
        return all(isinstance(value, float | int) and not isinstance(value, bool) for _, value in self.trials())


class RandomDistribution(Distribution):
    """A random value computed from uniform numbers in [0, 1)."""

    uniforms: ClassVar[int] = 1
    """Number of uniform numbers per value."""

    sampling: SamplingPlan = "independent"
    """Source of the uniform numbers: independent for each sample, or a space-filling sequence over all samples (Sobol
    sequence or Latin hypercube)."""

    def value(self, uniforms: Sequence[float]) -> Any:
        """Return the value for the given uniform numbers."""
        raise NotImplementedError

    @property
    def middle(self) -> Any:
        """The value at the centre of the distribution."""
        return self.value([0.5] * self.uniforms)


class RangeDistribution(RandomDistribution):
    """A random number between two limits."""

    low: Finite
    """Lower limit."""
    high: Finite
    """Upper limit."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.low < self.high:
            msg = f"has no values: low = {self.low:g} is not less than high = {self.high:g}"
            raise ValueError(msg)
        return self

    def trials(self) -> list[tuple[str, Any]]:
        """Return both limits."""
        return [("low", self.low), ("high", self.high)]


class IndexedDistribution(Distribution):
    """A value determined by the sample number alone."""

    period: ClassVar[bool] = False
    """Whether fields are combined as a grid: the next field advances after each full cycle of this field."""

    def __len__(self) -> int:
        raise NotImplementedError

    def value(self, place: int) -> Any:
        """Return the value at an index from 0 to the length."""
        raise NotImplementedError


class DerivedDistribution(Distribution):
    """A value computed from other values."""

    def needs(self) -> frozenset[str]:
        """Return the names or paths of the values that this value depends on."""
        raise NotImplementedError

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the value computed from the other values."""
        raise NotImplementedError

    def trials(self) -> list[tuple[str, Any]]:
        """Return an empty list: the values depend on other fields."""
        return []

    @property
    def is_number(self) -> bool:
        """Whether the value is always a number."""
        return False


class ChoiceDistribution(RandomDistribution):
    """One of several values; each may be a whole section of a scene, such as a texture, lamp or sensor.

    >>> ChoiceDistribution(values=["ovate", "cordate"], weights=[3, 1]).value([0.8])
    'cordate'
    """

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    """The values."""
    weights: tuple[NonNegative, ...] | None = None
    """Relative weights of the values; default: equal."""

    @model_validator(mode="after")
    def _weighted(self) -> Self:
        if self.weights is not None and len(self.weights) != len(self.values):
            msg = f"has {len(self.values)} values and {len(self.weights)} weights; specify one weight per value"
            raise ValueError(msg)
        if self.weights is not None and not sum(self.weights) > 0:
            msg = "has no values: all weights are zero"
            raise ValueError(msg)
        return self

    def value(self, uniforms: Sequence[float]) -> Any:
        """Return the value at a quantile of the cumulative weights."""
        ends = list(accumulate(self.weights or [1.0] * len(self.values)))
        # Values of zero weight are never selected.
        return self.values[min(bisect_right(ends, uniforms[0] * ends[-1]), self._last)]

    @property
    def _last(self) -> int:
        weights = self.weights or [1.0] * len(self.values)
        return max(place for place, weight in enumerate(weights) if weight > 0)

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value."""
        return [(f"values.{place}", value) for place, value in enumerate(self.values)]


class ConeDistribution(RandomDistribution):
    """A unit vector within an angle of an axis, uniformly distributed over the spherical cap (Archimedes).

    >>> ConeDistribution(axis=[0, 0, 2], half_angle_deg=90).value([0.5, 0.0])
    [0.8660254037844386, 0.0, 0.5]
    """

    uniforms: ClassVar[int] = 2

    kind: Literal["cone"] = "cone"
    axis: Direction
    """Central direction; its length is arbitrary."""
    half_angle_deg: Annotated[float, Field(gt=0, le=180)]
    """Largest angle between the axis and a direction; 180 for all directions."""

    def value(self, uniforms: Sequence[float]) -> list[float]:
        """Return the direction: the first number sets the polar angle, the second the azimuth."""
        cosine = 1 - uniforms[0] * (1 - np.cos(np.deg2rad(self.half_angle_deg)))
        return self._direction(float(cosine), 2 * np.pi * uniforms[1])

    def _direction(self, cosine: float, around: float) -> list[float]:
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        # Two directions orthogonal to the axis, from the unit vector that is least parallel to it.
        first = np.cross(axis, np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        sine = np.sqrt(max(1 - cosine**2, 0.0))
        found = cosine * axis + sine * (np.cos(around) * first + np.sin(around) * second)
        return [float(part) for part in found]

    def trials(self) -> list[tuple[str, Any]]:
        """Return the axis and four directions on the rim."""
        cosine = float(np.cos(np.deg2rad(self.half_angle_deg)))
        rim = [self._direction(cosine, np.pi / 2 * quarter) for quarter in range(4)]
        return [("axis", list(self.axis)), *(("half_angle_deg", one) for one in rim)]


def _readable(text: str) -> str:
    Expression(text)
    return text


class FormulaDistribution(DerivedDistribution):
    """A number computed from named values; the short form in a recipe is a string that begins with an equals sign.

    >>> FormulaDistribution(formula="distance_mm * tan(pi / 6)").value({"distance_mm": 600.0})
    346.41016151377545
    """

    kind: Literal["formula"] = "formula"
    formula: Annotated[str, Field(max_length=1000), AfterValidator(_readable)]
    """The formula: numbers, names of values, + - * / // % **, comparisons, ``a if b else c``, and the functions of
    `scenetruth.dataset.expression`."""
    integer: bool = False
    """Whether the result is rounded to an integer."""

    def needs(self) -> frozenset[str]:
        """Return the names in the formula."""
        return Expression(self.formula).names

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the result."""
        found = Expression(self.formula).value(values)
        return round(found) if self.integer else found

    @property
    def is_number(self) -> bool:
        """Always true."""
        return True


class GridDistribution(IndexedDistribution):
    """One axis of a grid: all fields of this type together run through every combination of their values.

    The first field in the recipe varies fastest.

    >>> [GridDistribution(low=1, high=2, count=3).value(place) for place in range(3)]
    [1.0, 1.5, 2.0]
    """

    period: ClassVar[bool] = True

    kind: Literal["grid"] = "grid"
    values: tuple[Any, ...] | None = None
    """The values; alternatively specify low, high and count."""
    low: Finite | None = None
    """First of the evenly spaced values."""
    high: Finite | None = None
    """Last of the evenly spaced values."""
    count: Annotated[int, Field(ge=2, le=1_000_000)] | None = None
    """Number of evenly spaced values."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ends = (self.low, self.high, self.count)
        if (self.values is None) == all(one is None for one in ends) or (
            self.values is None and any(one is None for one in ends)
        ):
            msg = "needs either values, or low, high and count"
            raise ValueError(msg)
        if self.values is not None and not self.values:
            msg = "has no values"
            raise ValueError(msg)
        return self

    def __len__(self) -> int:
        return len(self.values) if self.values is not None else int(self.count or 0)

    def value(self, place: int) -> Any:
        """Return the value at an index."""
        if self.values is not None:
            return self.values[place]
        low, high, count = self.low or 0.0, self.high or 0.0, self.count or 2
        return low + (high - low) * place / (count - 1)

    def trials(self) -> list[tuple[str, Any]]:
        """Return every listed value, or both limits."""
        if self.values is not None:
            return [(f"values.{place}", value) for place, value in enumerate(self.values)]
        return [("low", self.low), ("high", self.high)]


_Integer = Annotated[int, Field(ge=-(2**53), le=2**53)]


class IntegersDistribution(RandomDistribution):
    """A uniformly distributed integer; both limits are included.

    >>> [IntegersDistribution(low=1, high=3).value([u]) for u in (0.1, 0.5, 0.9)]
    [1, 2, 3]
    """

    kind: Literal["integers"] = "integers"
    low: _Integer
    """Smallest value."""
    high: _Integer
    """Largest value."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low > self.high:
            msg = f"has no values: low = {self.low} is more than high = {self.high}"
            raise ValueError(msg)
        return self

    def value(self, uniforms: Sequence[float]) -> int:
        """Return the integer at a quantile."""
        return min(self.low + int((self.high - self.low + 1) * uniforms[0]), self.high)

    def trials(self) -> list[tuple[str, Any]]:
        """Return both limits."""
        return [("low", self.low), ("high", self.high)]


class SequenceDistribution(IndexedDistribution):
    """The values of a list in order, repeated after the last: sample n has the n-th value.

    >>> SequenceDistribution(values=[3, 5]).value(1)
    5
    """

    kind: Literal["sequence"] = "sequence"
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    """The values."""

    def __len__(self) -> int:
        return len(self.values)

    def value(self, place: int) -> Any:
        """Return the value at an index."""
        return self.values[place]

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value."""
        return [(f"values.{place}", value) for place, value in enumerate(self.values)]


class LogUniformDistribution(RangeDistribution):
    """A number whose logarithm is uniformly distributed between two limits.

    >>> round(LogUniformDistribution(low=0.01, high=1).value([0.5]), 12)
    0.1
    """

    kind: Literal["log_uniform"] = "log_uniform"
    low: Positive
    """Lower limit."""
    high: Positive
    """Upper limit."""

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number at a quantile of the logarithmic scale."""
        found = self.low * math.exp(math.log(self.high / self.low) * uniforms[0])
        return min(max(found, self.low), self.high)


_FAR = 6.0
"""Range of trial values in standard deviations without truncation; 2e-9 of the values lie outside."""
_RARE = 1e-9


class NormalDistribution(RandomDistribution):
    """A normally distributed number, optionally truncated.

    >>> NormalDistribution(mean=5, std=2).value([0.5]), round(NormalDistribution(mean=0, std=1, low=0).value([0.5]), 4)
    (5.0, 0.6745)
    """

    kind: Literal["normal"] = "normal"
    mean: Finite
    """Mean before truncation."""
    std: Positive
    """Standard deviation before truncation."""
    low: Finite | None = None
    """Lower truncation limit; None for no limit."""
    high: Finite | None = None
    """Upper truncation limit; None for no limit."""

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.low is not None and self.high is not None and not self.low < self.high:
            msg = f"has no values: low = {self.low:g} is not less than high = {self.high:g}"
            raise ValueError(msg)
        below, above = self._shares()
        if above - below < _RARE:
            msg = (
                "has hardly any values between its limits (probability "
                f"{format_two_digits(above - below)}); adjust mean or limits"
            )
            raise ValueError(msg)
        return self

    def _shares(self) -> tuple[float, float]:
        from scipy.special import ndtr

        ends = [None if end is None else (end - self.mean) / self.std for end in (self.low, self.high)]
        return (0.0 if ends[0] is None else float(ndtr(ends[0]))), (1.0 if ends[1] is None else float(ndtr(ends[1])))

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the quantile of the truncated distribution."""
        from scipy.special import ndtri

        below, above = self._shares()
        found = self.mean + self.std * float(ndtri(below + (above - below) * uniforms[0]))
        found = found if self.low is None else max(found, self.low)
        return found if self.high is None else min(found, self.high)

    def trials(self) -> list[tuple[str, Any]]:
        """Return both limits, or distant quantiles without truncation."""
        low = ("low", self.low) if self.low is not None else ("std", self.mean - _FAR * self.std)
        high = ("high", self.high) if self.high is not None else ("std", self.mean + _FAR * self.std)
        return [low, high]


class RotationDistribution(RandomDistribution):
    """A uniformly distributed rotation, as a pose's list of ``rotations``.

    Quaternion from three uniform numbers (K. Shoemake, Uniform random rotations, Graphics Gems III, 1992).

    >>> RotationDistribution().value([0.5, 0.125, 0.25])
    [{'axis': [0.57735026919, 0.816496580928, 0.0], 'angle_deg': 120.0}]
    """

    uniforms: ClassVar[int] = 3

    kind: Literal["rotation"] = "rotation"

    def value(self, uniforms: Sequence[float]) -> list[dict[str, Any]]:
        """Return the rotation as one axis and angle."""
        share, one, other = uniforms
        sine, cosine = np.sqrt([1 - share, share])
        x, y = sine * np.sin(2 * np.pi * other), sine * np.cos(2 * np.pi * other)
        z, w = cosine * np.sin(2 * np.pi * one), cosine * np.cos(2 * np.pi * one)
        vector = np.array([z, x, y])
        length = float(np.linalg.norm(vector))
        if length < _NO_ROTATION:
            return [{"axis": [0.0, 0.0, 1.0], "angle_deg": 0.0}]
        angle = float(np.rad2deg(2 * np.arctan2(length, w)))
        return [{"axis": [round(float(part), 12) + 0.0 for part in vector / length], "angle_deg": round(angle, 12)}]

    def trials(self) -> list[tuple[str, Any]]:
        """Return one rotation: if a field accepts one, it accepts all."""
        return [("kind", self.value([0.3, 0.4, 0.5]))]


_NO_ROTATION = 1e-12


class LinkedDistribution(DerivedDistribution):
    """The value of another field or named value in the same sample.

    >>> LinkedDistribution(of="distance_mm").value({"distance_mm": 600.0})
    600.0
    """

    kind: Literal["linked"] = "linked"
    of: Name
    """Name or path of the other value."""

    def needs(self) -> frozenset[str]:
        """Return the name of the other value."""
        return frozenset({self.of})

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the other value."""
        return values[self.of]


_MAX_BYTES = 100_000_000


class TableDistribution(IndexedDistribution):
    """The values of one column of a CSV file with a header line: sample n uses the n-th row.

    Fields that name the same file use the same row. After the last row the first follows.
    """

    kind: Literal["table"] = "table"
    file: InputFile
    """The CSV file; a relative path is resolved against the directory of the recipe."""
    column: Name
    """Header of the column."""

    def __len__(self) -> int:
        return len(self._values())

    def value(self, place: int) -> Any:
        """Return the value of a row, as a number where possible."""
        return self._values()[place]

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value with its line number."""
        return [(f"column (line {line})", value) for line, value in enumerate(self._values(), start=2)]

    def problems(self) -> list[Problem]:
        """Return the reasons why the file or its column cannot be used."""
        try:
            if regular_file_size(Path(self.file)) > _MAX_BYTES:
                return [Problem("file", f"has more than {_MAX_BYTES:,} bytes", self.file)]
            columns = _load_columns(self.file)
        except (OSError, ValueError, csv.Error) as error:
            entries = getattr(error, "strerror", None) or error
            return [Problem("file", f"cannot be read: {entries}", self.file)]
        if self.column not in columns:
            return [Problem("column", f"is not in the table; its columns are {', '.join(columns)}", self.column)]
        if not columns[self.column]:
            return [Problem("file", "has no rows below its header", self.file)]
        return []

    def _values(self) -> tuple[Any, ...]:
        return _load_columns(self.file)[self.column]


def _load_columns(file: str) -> dict[str, tuple[Any, ...]]:
    """Return the columns of a table, which is read again when the file has changed."""
    found = os.stat(file)
    return _read_columns(file, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=16)
def _read_columns(file: str, changed_ns: int, size: int) -> dict[str, tuple[Any, ...]]:
    with Path(file).open(newline="", encoding="utf-8-sig") as stream:
        lines = [line for line in csv.reader(stream, strict=True) if line]
    if not lines:
        msg = "is empty"
        raise ValueError(msg)
    headings = [heading.strip() for heading in lines[0]]
    wrong = next((number for number, line in enumerate(lines, start=1) if len(line) != len(headings)), None)
    if wrong is not None:
        msg = f"line {wrong} has {len(lines[wrong - 1])} values for {len(headings)} columns"
        raise ValueError(msg)
    return {heading: tuple(_read_table(line[place]) for line in lines[1:]) for place, heading in enumerate(headings)}


def _read_table(text: str) -> Any:
    text = text.strip()
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)


class UniformDistribution(RangeDistribution):
    """A number uniformly distributed between two limits.

    >>> UniformDistribution(low=2, high=4).value([0.25])
    2.5
    """

    kind: Literal["uniform"] = "uniform"

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number at a quantile."""
        return self.low + (self.high - self.low) * uniforms[0]

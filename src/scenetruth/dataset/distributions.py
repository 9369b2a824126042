"""Distributions: the rules that draw the values of a varied field."""

from __future__ import annotations

import csv
import math
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
    """What the values of a varied field are, from sample to sample."""

    name: ValueName | None = None
    """What formulas call the value; the fields of ``values`` have their names already."""
    together: bool = False
    """Whether all places that a path with wildcards stands for have one value; if not, each has its own."""

    def trials(self) -> list[tuple[str, Any]]:
        """Return values, with the fields that they come from, that show whether all values fit: ends, every choice."""
        raise NotImplementedError

    def problems(self) -> list[Problem]:
        """Return what is wrong beyond what single fields tell, such as a file that cannot be read."""
        return []

    @property
    def is_number(self) -> bool:
        """Whether every value is a number, so that a column of numbers holds them."""
        return all(isinstance(value, float | int) and not isinstance(value, bool) for _, value in self.trials())


class RandomDistribution(Distribution):
    """A random value, made from numbers that are uniform between 0 and 1."""

    uniforms: ClassVar[int] = 1
    """How many uniform numbers make one value."""

    sampling: SamplingPlan = "independent"
    """Where the uniform numbers come from: each sample's own, or points that fill the space evenly over all samples
    (Sobol's sequence, a Latin hypercube)."""

    def value(self, uniforms: Sequence[float]) -> Any:
        """Return the value that uniform numbers make."""
        raise NotImplementedError

    @property
    def middle(self) -> Any:
        """A value in the middle."""
        return self.value([0.5] * self.uniforms)


class RangeDistribution(RandomDistribution):
    """A random number between two ends."""

    low: Finite
    """Lower end."""
    high: Finite
    """Upper end."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.low < self.high:
            msg = f"has no values: low = {self.low:g} is not less than high = {self.high:g}"
            raise ValueError(msg)
        return self

    def trials(self) -> list[tuple[str, Any]]:
        """Return both ends."""
        return [("low", self.low), ("high", self.high)]


class IndexedDistribution(Distribution):
    """A value that the number of the sample alone decides."""

    period: ClassVar[bool] = False
    """Whether grids multiply: the next field moves on when this one has gone through its values."""

    def __len__(self) -> int:
        """Return after how many samples the values repeat."""
        raise NotImplementedError

    def value(self, place: int) -> Any:
        """Return the value at a place from 0 to the length."""
        raise NotImplementedError


class DerivedDistribution(Distribution):
    """A value that other values decide."""

    def needs(self) -> frozenset[str]:
        """Return the names, or paths, of the values that it is made from."""
        raise NotImplementedError

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the value that others make."""
        raise NotImplementedError

    def trials(self) -> list[tuple[str, Any]]:
        """Return nothing: only samples show what comes of others."""
        return []

    @property
    def is_number(self) -> bool:
        """Whether it is always a number."""
        return False


class ChoiceDistribution(RandomDistribution):
    """One of several values; each may be a whole part of a scene, such as another texture, lamp or sensor.

    >>> ChoiceDistribution(values=["ovate", "cordate"], weights=[3, 1]).value([0.8])
    'cordate'
    """

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    """The values."""
    weights: tuple[NonNegative, ...] | None = None
    """How likely each is, in any unit; all alike if not given."""

    @model_validator(mode="after")
    def _weighted(self) -> Self:
        if self.weights is not None and len(self.weights) != len(self.values):
            msg = f"has {len(self.values)} values and {len(self.weights)} weights; give one for each"
            raise ValueError(msg)
        if self.weights is not None and not sum(self.weights) > 0:
            msg = "has no values: all weights are zero"
            raise ValueError(msg)
        return self

    def value(self, uniforms: Sequence[float]) -> Any:
        """Return the value at a share of all weights."""
        ends = list(accumulate(self.weights or [1.0] * len(self.values)))
        # What has no weight has no width, and is never met.
        return self.values[min(bisect_right(ends, uniforms[0] * ends[-1]), self._last)]

    @property
    def _last(self) -> int:
        weights = self.weights or [1.0] * len(self.values)
        return max(place for place, weight in enumerate(weights) if weight > 0)

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value."""
        return [(f"values.{place}", value) for place, value in enumerate(self.values)]


class ConeDistribution(RandomDistribution):
    """A unit vector within an angle of an axis, equally likely everywhere on the cap of the sphere (Archimedes).

    >>> ConeDistribution(axis=[0, 0, 2], half_angle_deg=90).value([0.5, 0.0])
    [0.8660254037844386, 0.0, 0.5]
    """

    uniforms: ClassVar[int] = 2

    kind: Literal["cone"] = "cone"
    axis: Direction
    """Direction in the middle, of any length."""
    half_angle_deg: Annotated[float, Field(gt=0, le=180)]
    """Largest angle between the axis and a direction; 180 for all directions."""

    def value(self, uniforms: Sequence[float]) -> list[float]:
        """Return the direction: the first number says how far from the axis, the second where around it."""
        cosine = 1 - uniforms[0] * (1 - np.cos(np.deg2rad(self.half_angle_deg)))
        return self._direction(float(cosine), 2 * np.pi * uniforms[1])

    def _direction(self, cosine: float, around: float) -> list[float]:
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        # Two directions square to the axis, from the unit vector that is least like it.
        first = np.cross(axis, np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        sine = np.sqrt(max(1 - cosine**2, 0.0))
        found = cosine * axis + sine * (np.cos(around) * first + np.sin(around) * second)
        return [float(part) for part in found]

    def trials(self) -> list[tuple[str, Any]]:
        """Return the axis and some directions on the rim."""
        cosine = float(np.cos(np.deg2rad(self.half_angle_deg)))
        rim = [self._direction(cosine, np.pi / 2 * quarter) for quarter in range(4)]
        return [("axis", list(self.axis)), *(("half_angle_deg", one) for one in rim)]


def _readable(text: str) -> str:
    Expression(text)
    return text


class FormulaDistribution(DerivedDistribution):
    """A number computed from named values; in a recipe also written as a text that begins with an equals sign.

    >>> FormulaDistribution(formula="distance_mm * tan(pi / 6)").value({"distance_mm": 600.0})
    346.41016151377545
    """

    kind: Literal["formula"] = "formula"
    formula: Annotated[str, Field(max_length=1000), AfterValidator(_readable)]
    """The formula: numbers, names of values, + - * / // % **, comparisons, ``a if b else c``, and the functions of
    `scenetruth.dataset.expression`."""
    integer: bool = False
    """Whether the result is rounded to a whole number."""

    def needs(self) -> frozenset[str]:
        """Return the names in the formula."""
        return Expression(self.formula).names

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the result."""
        found = Expression(self.formula).value(values)
        return round(found) if self.integer else found

    @property
    def is_number(self) -> bool:
        """Whether it is always a number: it is."""
        return True


class GridDistribution(IndexedDistribution):
    """One axis of a grid: all fields of this kind together go through every combination of their values.

    The first field in the recipe changes with every sample, the next when the first has gone through its values, and
    so on.

    >>> [GridDistribution(low=1, high=2, count=3).value(place) for place in range(3)]
    [1.0, 1.5, 2.0]
    """

    period: ClassVar[bool] = True

    kind: Literal["grid"] = "grid"
    values: tuple[Any, ...] | None = None
    """The values; or give low, high and count."""
    low: Finite | None = None
    """The first of evenly spaced values."""
    high: Finite | None = None
    """The last."""
    count: Annotated[int, Field(ge=2, le=1_000_000)] | None = None
    """How many."""

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
        """Return how many values the axis has."""
        return len(self.values) if self.values is not None else int(self.count or 0)

    def value(self, place: int) -> Any:
        """Return the value at a place."""
        if self.values is not None:
            return self.values[place]
        low, high, count = self.low or 0.0, self.high or 0.0, self.count or 2
        return low + (high - low) * place / (count - 1)

    def trials(self) -> list[tuple[str, Any]]:
        """Return every given value, or both ends."""
        if self.values is not None:
            return [(f"values.{place}", value) for place, value in enumerate(self.values)]
        return [("low", self.low), ("high", self.high)]


_Integer = Annotated[int, Field(ge=-(2**53), le=2**53)]


class IntegersDistribution(RandomDistribution):
    """A whole number, each between two ends equally likely, the ends among them.

    >>> [IntegersDistribution(low=1, high=3).value([u]) for u in (0.1, 0.5, 0.9)]
    [1, 2, 3]
    """

    kind: Literal["integers"] = "integers"
    low: _Integer
    """The least."""
    high: _Integer
    """The largest."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low > self.high:
            msg = f"has no values: low = {self.low} is more than high = {self.high}"
            raise ValueError(msg)
        return self

    def value(self, uniforms: Sequence[float]) -> int:
        """Return the number at a share of all."""
        return min(self.low + int((self.high - self.low + 1) * uniforms[0]), self.high)

    def trials(self) -> list[tuple[str, Any]]:
        """Return both ends."""
        return [("low", self.low), ("high", self.high)]


class SequenceDistribution(IndexedDistribution):
    """The values of a list in their order: sample n has the n-th, and after the last comes the first again.

    >>> SequenceDistribution(values=[3, 5]).value(1)
    5
    """

    kind: Literal["sequence"] = "sequence"
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    """The values."""

    def __len__(self) -> int:
        """Return how many values there are."""
        return len(self.values)

    def value(self, place: int) -> Any:
        """Return the value at a place."""
        return self.values[place]

    def trials(self) -> list[tuple[str, Any]]:
        """Return every value."""
        return [(f"values.{place}", value) for place, value in enumerate(self.values)]


class LogUniformDistribution(RangeDistribution):
    """A number whose logarithm is equally likely anywhere between two ends: each factor of two as likely as the next.

    >>> round(LogUniformDistribution(low=0.01, high=1).value([0.5]), 12)
    0.1
    """

    kind: Literal["log_uniform"] = "log_uniform"
    low: Positive
    """Lower end."""
    high: Positive
    """Upper end."""

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number at a share of the way from low to high, on a logarithmic scale."""
        found = self.low * math.exp(math.log(self.high / self.low) * uniforms[0])
        return min(max(found, self.low), self.high)


_FAR = 6.0
"""Standard deviations that are looked at where nothing is cut off: two of a thousand million lie beyond."""
_RARE = 1e-9


class NormalDistribution(RandomDistribution):
    """A normally distributed number; of values outside the ends, none.

    >>> NormalDistribution(mean=5, std=2).value([0.5]), round(NormalDistribution(mean=0, std=1, low=0).value([0.5]), 4)
    (5.0, 0.6745)
    """

    kind: Literal["normal"] = "normal"
    mean: Finite
    """Mean, before anything is cut off."""
    std: Positive
    """Standard deviation, before anything is cut off."""
    low: Finite | None = None
    """No value lies below; None: nothing is cut off."""
    high: Finite | None = None
    """No value lies above; None: nothing is cut off."""

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.low is not None and self.high is not None and not self.low < self.high:
            msg = f"has no values: low = {self.low:g} is not less than high = {self.high:g}"
            raise ValueError(msg)
        below, above = self._shares()
        if above - below < _RARE:
            msg = f"has hardly any values between its ends: {above - below:.2g} of the normal ones; move mean or ends"
            raise ValueError(msg)
        return self

    def _shares(self) -> tuple[float, float]:
        """Return the shares of the whole distribution that lie below both ends."""
        from scipy.special import ndtr

        ends = [None if end is None else (end - self.mean) / self.std for end in (self.low, self.high)]
        return (0.0 if ends[0] is None else float(ndtr(ends[0]))), (1.0 if ends[1] is None else float(ndtr(ends[1])))

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number below which the given share of all values lies."""
        from scipy.special import ndtri

        below, above = self._shares()
        found = self.mean + self.std * float(ndtri(below + (above - below) * uniforms[0]))
        found = found if self.low is None else max(found, self.low)
        return found if self.high is None else min(found, self.high)

    def trials(self) -> list[tuple[str, Any]]:
        """Return both ends, or what lies very far out."""
        low = ("low", self.low) if self.low is not None else ("std", self.mean - _FAR * self.std)
        high = ("high", self.high) if self.high is not None else ("std", self.mean + _FAR * self.std)
        return [low, high]


class RotationDistribution(RandomDistribution):
    """Any rotation, all equally likely, as a pose's list of ``rotations``.

    From three uniform numbers as K. Shoemake, Uniform random rotations, Graphics Gems III (1992), makes a quaternion.

    >>> RotationDistribution().value([0.5, 0.125, 0.25])
    [{'axis': [0.57735026919, 0.816496580928, 0.0], 'angle_deg': 120.0}]
    """

    uniforms: ClassVar[int] = 3

    kind: Literal["rotation"] = "rotation"

    def value(self, uniforms: Sequence[float]) -> list[dict[str, Any]]:
        """Return the rotation as one turn about one axis."""
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
        """Return one rotation: where one is allowed, all are."""
        return [("kind", self.value([0.3, 0.4, 0.5]))]


_NO_ROTATION = 1e-12


class LinkedDistribution(DerivedDistribution):
    """The value that another field, or another named value, has in the same sample.

    >>> LinkedDistribution(of="distance_mm").value({"distance_mm": 600.0})
    600.0
    """

    kind: Literal["linked"] = "linked"
    of: Name
    """Name or path of the other value."""

    def needs(self) -> frozenset[str]:
        """Return the other value's name."""
        return frozenset({self.of})

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the other value."""
        return values[self.of]


_MAX_BYTES = 100_000_000


class TableDistribution(IndexedDistribution):
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
            if regular_file_size(Path(self.file)) > _MAX_BYTES:
                return [Problem("file", f"has more than {_MAX_BYTES:,} bytes", self.file)]
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
    """A number that is equally likely anywhere between two ends.

    >>> UniformDistribution(low=2, high=4).value([0.25])
    2.5
    """

    kind: Literal["uniform"] = "uniform"

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number at a share of the way from low to high."""
        return self.low + (self.high - self.low) * uniforms[0]

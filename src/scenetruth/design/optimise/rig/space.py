"""The space of what is free: numbers between 0 and 1 for every parameter, and the values that they stand for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Parameter", "Space"]

_DIGITS = 4
"""Digits of numbers that are searched: nobody builds a rig to more."""


@dataclass(frozen=True)
class Parameter:
    """One free parameter.

    Parameters
    ----------
    name
        Path of a field, or a name that goals know.
    low, high
        Ends of a range.
    logarithmic
        Whether it is searched on a logarithmic scale.
    whole
        Whether its values are whole numbers.
    choices
        Values to choose from, instead of a range.
    """

    name: str
    low: float = 0.0
    high: float = 1.0
    logarithmic: bool = False
    whole: bool = False
    choices: tuple[Any, ...] = ()

    def value(self, unit: float) -> Any:
        """Return the value that a number from 0 to 1 stands for."""
        if self.choices:
            return self.choices[min(int(unit * len(self.choices)), len(self.choices) - 1)]
        if self.whole and not self.logarithmic:
            first, last = math.ceil(self.low), math.floor(self.high)
            return min(first + int(unit * (last - first + 1)), last)
        if self.logarithmic:
            value = float(self.low * (self.high / self.low) ** unit)
        else:
            value = self.low + (self.high - self.low) * unit
        return self.rounded(value)

    def rounded(self, value: float) -> float | int:
        """Return a number of the range as it is told: whole, or with few digits; inside the range."""
        if self.whole:
            return min(max(round(value), math.ceil(self.low)), math.floor(self.high))
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def unit(self, value: Any) -> float:
        """Return a number from 0 to 1 that stands for a value."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices)
        if self.whole and not self.logarithmic:
            first, last = math.ceil(self.low), math.floor(self.high)
            return float((value - first + 0.5) / (last - first + 1))
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (float(value) - self.low) / (self.high - self.low)

    @property
    def levels(self) -> int:
        """How many values there are; 0 for a range of real numbers."""
        if self.choices:
            return len(self.choices)
        return math.floor(self.high) - math.ceil(self.low) + 1 if self.whole else 0


@dataclass(frozen=True)
class Space:
    """All free parameters.

    Parameters
    ----------
    parameters
        In the order of the goal.
    """

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        """Return how many parameters there are."""
        return len(self.parameters)

    @property
    def names(self) -> list[str]:
        """Their names."""
        return [one.name for one in self.parameters]

    def values(self, point: Sequence[float]) -> dict[str, Any]:
        """Return the values of a point of the unit cube, by name."""
        return {one.name: one.value(float(unit)) for one, unit in zip(self.parameters, point, strict=True)}

    def point(self, values: Mapping[str, Any]) -> list[float]:
        """Return a point of the unit cube that stands for values."""
        return [one.unit(values[one.name]) for one in self.parameters]

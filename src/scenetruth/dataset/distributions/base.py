"""What every kind of varied value has in common: random ones, those that go by the sample's number, derived ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scenetruth.errors import Problem
from scenetruth.model import Finite, FrozenModel

__all__ = ["Between", "ByNumber", "Derived", "Distribution", "Plan", "Random", "ValueName"]

Plan = Literal["independent", "sobol", "latin_hypercube"]
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


class Random(Distribution):
    """A random value, made from numbers that are uniform between 0 and 1."""

    uniforms: ClassVar[int] = 1
    """How many uniform numbers make one value."""

    plan: Plan = "independent"
    """Where the uniform numbers come from: each sample's own, or points that fill the space evenly over all samples
    (Sobol's sequence, a Latin hypercube)."""

    def value(self, uniforms: Sequence[float]) -> Any:
        """Return the value that uniform numbers make.

        Parameters
        ----------
        uniforms
            As many as `uniforms`, each above 0 and below 1.
        """
        raise NotImplementedError

    @property
    def middle(self) -> Any:
        """A value in the middle."""
        return self.value([0.5] * self.uniforms)


class Between(Random):
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


class ByNumber(Distribution):
    """A value that the number of the sample alone decides."""

    period: ClassVar[bool] = False
    """Whether grids multiply: the next field moves on when this one has gone through its values."""

    def __len__(self) -> int:
        """Return after how many samples the values repeat."""
        raise NotImplementedError

    def value(self, place: int) -> Any:
        """Return the value at a place from 0 to the length."""
        raise NotImplementedError


class Derived(Distribution):
    """A value that other values decide."""

    def needs(self) -> frozenset[str]:
        """Return the names, or paths, of the values that it is made from."""
        raise NotImplementedError

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the value that others make.

        Raises
        ------
        ValueError
            If they make none; says why.
        """
        raise NotImplementedError

    def trials(self) -> list[tuple[str, Any]]:
        """Return nothing: only samples show what comes of others."""
        return []

    @property
    def is_number(self) -> bool:
        """Whether it is always a number."""
        return False

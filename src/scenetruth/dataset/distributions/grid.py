"""Values of a grid: every one together with every one of all other grids."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scenetruth.dataset.distributions.base import ByNumber
from scenetruth.model import Finite

__all__ = ["Grid"]


class Grid(ByNumber):
    """One axis of a grid: all fields of this kind together go through every combination of their values.

    The first field in the recipe changes with every sample, the next when the first has gone through its values, and
    so on.

    Examples
    --------
    >>> [Grid(low=1, high=2, count=3).value(place) for place in range(3)]
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

"""Whole numbers between two ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scenetruth.dataset.distributions.base import Random

__all__ = ["Integers"]

_Integer = Annotated[int, Field(ge=-(2**53), le=2**53)]


class Integers(Random):
    """A whole number, each between two ends equally likely, the ends among them.

    Examples
    --------
    >>> [Integers(low=1, high=3).value([u]) for u in (0.1, 0.5, 0.9)]
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

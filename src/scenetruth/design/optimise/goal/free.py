"""What is free in a goal: a range of numbers, some values, or entries of a catalogue."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from scenetruth.model import Finite, FrozenModel

__all__ = ["Free"]


class Free(FrozenModel):
    """A range ``{from: 2, to: 40, log: true}``, or ``{values: [60, 300]}``, which a list may stand for.

    Of a catalogue, the values are names of entries, or ``all``.
    """

    model_config = ConfigDict(populate_by_name=True)

    from_: Finite | None = Field(default=None, alias="from")
    """Low end of a range."""
    to: Finite | None = None
    """High end of a range."""
    log: bool = False
    """Whether the range is searched evenly on a logarithmic scale."""
    values: tuple[Any, ...] | Literal["all"] | None = None
    """Values to choose from."""

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, given: Any) -> Any:
        return {"values": given} if isinstance(given, list | tuple | str) else given

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        low, high = self.from_, self.to
        if (self.values is None) == (low is None and high is None):
            msg = "must be a range, {from: 2, to: 40}, or choices, {values: [60, 300]}"
            raise ValueError(msg)
        if self.values is not None:
            if self.log:
                msg = "has values, which no logarithmic scale changes: leave out log"
                raise ValueError(msg)
            return self
        if low is None or high is None:
            msg = f"has no {'from' if low is None else 'to'}: a range needs both ends"
            raise ValueError(msg)
        if not low < high:
            msg = f"has no values: from {low:g} is not below to {high:g}"
            raise ValueError(msg)
        if self.log and low <= 0:
            msg = f"is logarithmic, and must begin above 0 (from {low:g}): leave out log"
            raise ValueError(msg)
        return self

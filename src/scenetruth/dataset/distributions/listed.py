"""Values in a given order, from the first again when they end."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from scenetruth.dataset.distributions.base import ByNumber

__all__ = ["Listed"]


class Listed(ByNumber):
    """The values of a list in their order: sample n has the n-th, and after the last comes the first again.

    Examples
    --------
    >>> Listed(values=[3, 5]).value(1)
    5
    """

    kind: Literal["list"] = "list"
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

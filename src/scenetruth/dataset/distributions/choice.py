"""One of several values, which may be whole parts of a scene."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scenetruth.dataset.distributions.base import Random
from scenetruth.model import NonNegative

__all__ = ["Choice"]


class Choice(Random):
    """One of several values; each may be a whole part of a scene, such as another texture, lamp or sensor.

    Examples
    --------
    >>> Choice(values=["ovate", "cordate"], weights=[3, 1]).value([0.8])
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

"""Normally distributed numbers, cut off where they must be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

from pydantic import model_validator

from scenetruth.dataset.distributions.base import Random
from scenetruth.model import Finite, Positive

__all__ = ["Normal"]

_FAR = 6.0
"""Standard deviations that are looked at where nothing is cut off: two of a thousand million lie beyond."""
_RARE = 1e-9


class Normal(Random):
    """A normally distributed number; of values outside the ends, none.

    Examples
    --------
    >>> Normal(mean=5, std=2).value([0.5]), round(Normal(mean=0, std=1, low=0).value([0.5]), 4)
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

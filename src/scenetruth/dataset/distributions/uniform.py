"""Numbers that are equally likely between two ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from scenetruth.dataset.distributions.base import Between

__all__ = ["Uniform"]


class Uniform(Between):
    """A number that is equally likely anywhere between two ends.

    Examples
    --------
    >>> Uniform(low=2, high=4).value([0.25])
    2.5
    """

    kind: Literal["uniform"] = "uniform"

    def value(self, uniforms: Sequence[float]) -> float:
        """Return the number at a share of the way from low to high."""
        return self.low + (self.high - self.low) * uniforms[0]

"""Numbers whose logarithm is equally likely between two ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from scenetruth.dataset.distributions.base import Between
from scenetruth.model import Positive

__all__ = ["LogUniform"]


class LogUniform(Between):
    """A number whose logarithm is equally likely anywhere between two ends: each factor of two as likely as the next.

    Examples
    --------
    >>> round(LogUniform(low=0.01, high=1).value([0.5]), 12)
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

"""What the rig costs."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Price"]


class Price(Limit):
    """Sum of the prices of what is from catalogues, in euros; entries without a price are not allowed."""

    unit: ClassVar[str] = "EUR"

    kind: Literal["price"] = "price"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "price"

    def value(self, facts: Facts) -> float:
        """Return the sum; NaN if a price is not known."""
        return math.nan if facts.price is None else facts.price

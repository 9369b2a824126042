"""How far points move in the image from one position to the next."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Disparity"]


class Disparity(Limit):
    """Disparity of a step at the median depth of the first objective's region: f B / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["disparity"] = "disparity"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "disparity per step"

    def value(self, facts: Facts) -> float:
        """Return the disparity, without its sign."""
        return abs(facts.causes.disparity_px)

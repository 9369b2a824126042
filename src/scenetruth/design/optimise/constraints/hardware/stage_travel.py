"""How far the stage must travel."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["StageTravel"]


class StageTravel(Limit):
    """Distance of the outermost positions."""

    unit: ClassVar[str] = "mm"

    kind: Literal["stage_travel"] = "stage_travel"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "stage travel"

    def value(self, facts: Facts) -> float:
        """Return the distance."""
        return facts.travel_mm

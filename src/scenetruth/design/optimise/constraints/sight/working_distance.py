"""How far what is measured stands from the camera."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["WorkingDistance"]


class WorkingDistance(Limit):
    """Median depth of the first objective's region."""

    unit: ClassVar[str] = "mm"

    kind: Literal["working_distance"] = "working_distance"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "working distance"

    def value(self, facts: Facts) -> float:
        """Return the median depth."""
        return facts.depth_mm

"""How far points move in the image from frame to frame."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Flow"]


class Flow(Limit):
    """Optical flow, median length over the first objective's region."""

    unit: ClassVar[str] = "px/frame"

    kind: Literal["flow"] = "flow"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "motion in the image from frame to frame"

    def value(self, facts: Facts) -> float:
        """Return the length."""
        return facts.causes.flow_px

"""How long it is from frame to frame."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["FrameInterval"]


class FrameInterval(Limit):
    """Time from frame to frame."""

    unit: ClassVar[str] = "s"

    kind: Literal["frame_interval"] = "frame_interval"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time from frame to frame"

    def value(self, facts: Facts) -> float:
        """Return the time."""
        return facts.scene.frames.frame_interval_s

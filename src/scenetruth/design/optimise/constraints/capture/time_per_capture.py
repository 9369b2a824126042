"""How long the images of one frame take."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["TimePerCapture"]


class TimePerCapture(Limit):
    """Time from the first image of a frame to the end of the last: positions times travel, settling and exposure."""

    unit: ClassVar[str] = "s"

    kind: Literal["time_per_capture"] = "time_per_capture"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time per capture"

    def value(self, facts: Facts) -> float:
        """Return the time."""
        each = max(facts.scene.stage.time_per_position_s, facts.scene.shutter.exposure_time_s)
        return facts.images_per_frame * each

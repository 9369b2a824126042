"""How long a recording takes."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["RecordingTime"]


class RecordingTime(Limit):
    """Time from the first frame to the last; of the frames that are estimated together, if wanted."""

    unit: ClassVar[str] = "s"

    kind: Literal["recording_time"] = "recording_time"

    of: Literal["recording", "window"] = "recording"
    """Of all frames, or of those that are estimated together."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time from the first frame to the last" + (" of a window" if self.of == "window" else "")

    def value(self, facts: Facts) -> float:
        """Return the time."""
        frames = facts.causes.frames if self.of == "window" else facts.scene.frames.count
        return (frames - 1) * facts.scene.frames.frame_interval_s

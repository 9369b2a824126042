"""The time that the stage takes from position to position."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Disturbance, Sight, moved
from scenetruth.design.budget.stage_cause import schedule_of_stage
from scenetruth.scene import Scene


class Timing(Cause):
    """The object moves on while the stage travels: motion is taken for depth."""

    kind = "timing"
    title = "time between positions"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.time_per_position_s": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the time per position."""
        return f"{scene.stage.time_per_position_s:g} s per position"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the motion up to the time at which each image is taken."""
        schedule = schedule_of_stage(sight.scene)
        interval = sight.scene.frames.frame_interval_s
        yield lambda s, t: moved(sight, s, t, schedule.offset_s(s, t) / interval)

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return half the time, or what takes more of it away."""
        half = scene.stage.time_per_position_s / 2
        return Remedy(f"half the time per position (stage.time_per_position_s: {half:g})", {self.kind: 0.5})

"""Rows of an image that are exposed one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Sight, moved
from scenetruth.scene import Scene


class RollingShutter(Cause):
    """A point that changes its row changes its time as well."""

    kind = "rolling_shutter"
    title = "rolling shutter"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"shutter.readout_time_s": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the time from the first row to the last."""
        return f"{scene.shutter.readout_time_s:g} s"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the motion from the time of the reference's row to that of the image's."""
        shutter, height = sight.scene.shutter, sight.scene.camera.height
        interval = sight.scene.frames.frame_interval_s
        first = sight.points.y - sight.points.y[0, 0]

        def change(s: int, t: int) -> Change:
            row = sight.place(s, t).y - sight.points.y[0, 0]
            later = shutter.row_offsets_s(row, height) - shutter.row_offsets_s(first, height)
            return moved(sight, s, t, later / interval)

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a global shutter."""
        return Remedy("a global shutter (shutter.readout_time_s: 0)", {self.kind: 0.0})

"""Errors over the motion in the image: how fast things may move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet, wall


class MotionRange(Case):
    """A sheet that moves faster and faster."""

    kind = "motion"
    title = "Range of motion"
    question = "Over which motions in the image does it find them?"
    varied = "flow, px per frame"
    core = (0.1, 1.3, 6.3)
    full = (0.01, 0.03, 0.1, 0.3, 1.3, 3.3, 6.3, 12.3)
    headline = ("flow_x", "rms")
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, moving along X and a little towards the camera."""
        fast = wall(velocity=(value, 0.0, -0.2 * value), size_mm=(240 + 4 * value, 200))
        return sheet({"objects": [fast], "frames.count": 3})

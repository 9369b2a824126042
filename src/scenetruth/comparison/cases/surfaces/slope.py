"""Errors over the slope of the surface: windows see several depths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet, wall


class Slope(Case):
    """A sheet that is turned about the vertical."""

    kind = "slope"
    title = "Slope"
    question = "How steep may a surface be?"
    varied = "angle to the image plane, degrees"
    core = (30.0, 60.0)
    full = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0)

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, turned, and so large that it fills the image."""
        turned = wall(size_mm=(700, 260))
        turned["pose"]["rotations"] = [{"axis": [0, 1, 0], "angle_deg": value}]
        return sheet({"objects": [turned]}, baseline_mm=12.3)

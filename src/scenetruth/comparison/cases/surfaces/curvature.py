"""Errors over curvature: a cylinder is nearer in the middle of a window than at its ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import DISTANCE_MM, sheet, wall


class Curvature(Case):
    """Upright cylinders, thinner and thinner."""

    kind = "curvature"
    title = "Curvature"
    question = "How curved may a surface be?"
    varied = "curvature, 1/m"
    core = (20.0,)
    full = (2.0, 5.0, 10.0, 20.0, 40.0)
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return a cylinder whose nearest line is where the sheet would be, before a background."""
        radius = 1000.0 / value
        round_one = wall("cylinder")
        # Its axis is Z of its own, and stands upright here.
        round_one["mesh"] = {"kind": "cylinder", "radius_mm": radius, "length_mm": 240, "resolution_mm": 2.0}
        round_one["pose"] = {
            "position_mm": [0.0, 0.0, DISTANCE_MM + radius],
            "rotations": [{"axis": [1, 0, 0], "angle_deg": 90}],
        }
        behind = wall("behind", distance_mm=DISTANCE_MM + 2.5 * radius, size_mm=(1200, 900))
        return sheet({"objects": [round_one, behind]}, baseline_mm=12.3)

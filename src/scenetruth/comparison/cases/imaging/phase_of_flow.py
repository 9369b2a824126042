"""The bias over the sub-pixel phase of motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class PhaseOfFlow(Case):
    """A sheet that moves across by another fraction of a pixel per frame, without noise."""

    kind = "phase_of_flow"
    title = "Phase of motion"
    question = "Does the error of motion depend on the fraction of a pixel?"
    varied = "flow, px per frame"
    core = (0.0, 0.25, 0.75)
    full = tuple(k / 16 for k in range(17))
    headline = ("flow_x", "bias")
    quantities = ("velocity_x", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, moving along X."""
        return sheet({"objects.0.motion.0.velocity_mm_per_frame": [value, 0.0, 0.0]})

    def noise_std(self, value: float) -> float:
        """Return none: biases are small."""
        return 0.0

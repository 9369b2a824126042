"""The bias over the sub-pixel phase of disparity: what interpolation and locking to whole pixels cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class PhaseOfDisparity(Case):
    """A sheet whose disparity has another fraction of a pixel, without noise."""

    kind = "phase_of_disparity"
    title = "Phase of disparity"
    question = "Does the error depend on where between two pixels a point is seen by the next camera?"
    varied = "disparity, px per step"
    core = (4.0, 4.25, 4.75)
    full = tuple(4 + k / 16 for k in range(17))
    headline = ("disparity", "bias")
    quantities = ("depth", "disparity")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, at rest: more frames would show the same."""
        return sheet({"objects.0.motion": [], "frames.count": 3}, baseline_mm=value)

    def noise_std(self, value: float) -> float:
        """Return none: biases are small."""
        return 0.0

"""Errors over disparity: how far apart cameras may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet, wall


class DisparityRange(Case):
    """A sheet seen from positions farther and farther apart."""

    kind = "disparity"
    title = "Range of disparity"
    question = "Over which disparities does it find depth?"
    varied = "disparity, px per step"
    core = (1.3, 20.3)
    full = (0.6, 1.3, 2.6, 5.3, 10.3, 20.3, 40.3)
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return three positions so far apart."""
        wide = wall(size_mm=(240 + 2 * value, 190))
        return sheet({"objects": [wide], "stage.positions": 3}, baseline_mm=value)

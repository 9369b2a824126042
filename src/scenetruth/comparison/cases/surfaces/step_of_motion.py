"""A step in velocity within one depth: how far from it errors of motion reach."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.comparison.case import Case, Mask, inner
from scenetruth.comparison.sheet import sheet, wall


class StepOfMotion(Case):
    """Two sheets in one plane whose edges meet, which move apart along the edge."""

    kind = "step_of_motion"
    title = "Step of motion"
    question = "How close to a step of velocity does it measure?"
    varied = "distance from the step, px"
    core = (1.5, 4.5, 9.5)
    full = (0.5, 1.5, 2.5, 3.5, 4.5, 6.5, 9.5, 14.5)
    margin_px = 18.0
    quantities = ("velocity_y", "flow_y")
    headline = ("flow_y", "rms")
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheets, side by side."""
        left = wall("left", size_mm=(130, 260), centre_mm=(-65.0, 0.0), velocity=(0.0, 0.4, 0.0))
        right = wall("right", size_mm=(130, 260), centre_mm=(65.0, 0.0), velocity=(0.0, -0.4, 0.0))
        return sheet({"objects": [left, right]})

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels at a distance from the step."""
        off = np.abs(truth["boundary_distance"].values - value)
        return np.asarray(np.isfinite(truth["depth"].values) & inner(truth, self.margin_px) & (off <= 1.0))

"""Errors of points that some of the cameras do not see."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.comparison.case import Case, Mask, inner
from scenetruth.comparison.sheet import sheet, wall


class Occlusion(Case):
    """Bars before a sheet; pixels that all images show, or that some of them do not."""

    kind = "occlusion"
    title = "Occlusion"
    question = "Does it measure what some cameras do not see?"
    varied = "which images see it"
    core = (0.0, 1.0)
    margin_px = 22.0
    one_scene = True

    def labels(self) -> Mapping[float, str]:
        """Return what both values mean."""
        return {0.0: "some", 1.0: "all"}

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return three upright bars before a sheet."""
        bars = [
            wall(f"bar-{n}", distance_mm=600.0, size_mm=(12, 260), centre_mm=(x, 0.0), velocity=(0.2, 0.0, 0.0))
            for n, x in enumerate((-40.0, 0.0, 40.0))
        ]
        return sheet({"objects": [wall(distance_mm=760.0, size_mm=(320, 240)), *bars]}, baseline_mm=8.3)

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels of the sheet that all images show, or those that some do not."""
        there = np.isfinite(truth["depth"].values) & (truth["object_id"].values == 0) & inner(truth, self.margin_px)
        # Right at an outline a pixel is half of each.
        there &= truth["boundary_distance"].values >= 1.5
        return np.asarray(there & (truth["seen_throughout"].values == bool(value)))

"""A step in depth: how far from an outline errors reach, on both of its sides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.comparison.case import Case, Mask, inner
from scenetruth.comparison.sheet import sheet, wall

_WIDTH_PX = 1.0
"""Pixels within so much of a distance are measured."""


class EdgeOfDepth(Case):
    """A sheet with an upright edge before another; pixels at one distance from the edge after the other."""

    kind = "edge_of_depth"
    title = "Outline"
    question = "How close to an outline does it measure?"
    varied = "distance from the outline, px"
    core = (1.5, 4.5, 9.5)
    full = (0.5, 1.5, 2.5, 3.5, 4.5, 6.5, 9.5, 14.5)
    margin_px = 22.0
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return two sheets, a sixth of the distance apart, that move against each other."""
        near = wall("near", distance_mm=640.0, size_mm=(60, 300), velocity=(0.3, -0.2, 0.1))
        far = wall("far", distance_mm=760.0, size_mm=(320, 240), velocity=(-0.2, 0.3, 0.0))
        return sheet({"objects": [near, far]}, baseline_mm=8.3)

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels at a distance from the outline."""
        off = np.abs(truth["boundary_distance"].values - value)
        return np.asarray(np.isfinite(truth["depth"].values) & inner(truth, self.margin_px) & (off <= _WIDTH_PX))

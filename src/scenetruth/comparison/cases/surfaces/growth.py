"""Errors of the growth rate over the interval between frames: what it is worth to wait."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.growing import growth_rows
from scenetruth.comparison.rows import Row
from scenetruth.comparison.sheet import sheet

__all__ = ["Growth", "growing_sheet"]


def growing_sheet(rate_per_hour: float, interval_min: float) -> Mapping[str, Any]:
    """Return the sheet, turned by 20 degrees, that grows.

    Parameters
    ----------
    rate_per_hour
        Relative growth rate of its area.
    interval_min
        Time between frames in minutes.
    """
    return sheet(
        {
            "frames.frame_interval_s": 60 * interval_min,
            "objects.0.motion": [],
            "objects.0.mesh.resolution_mm": 2.0,
            "objects.0.pose.rotations": [{"axis": [0, 1, 0], "angle_deg": 20}],
            "objects.0.deformation": [{"kind": "growth", "rate_per_hour": rate_per_hour, "along_share": 0.5}],
        },
        baseline_mm=12.3,
    )


class Growth(Case):
    """A sheet that grows at 3 % per hour, looked at more and more seldom."""

    kind = "growth"
    title = "Growth over intervals"
    question = "How well is growth measured, over 20 px, at which interval?"
    varied = "interval between frames, minutes"
    core = (2.0, 15.0)
    full = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
    headline = ("growth_rate_windowed", "rms")
    logarithmic = True
    quantities = ("velocity_z", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet that grows at 3 % per hour."""
        return growing_sheet(0.03, value)

    def further_rows(self, found: Found) -> Iterable[Row]:
        """Return the errors of the growth rate over windows, in % per hour."""
        return growth_rows(self, found)

"""Errors of the growth rate over the rate itself: whether fast growth costs, and what is found where nothing grows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.cases.surfaces.growth import growing_sheet
from scenetruth.comparison.measures.growing import growth_rows
from scenetruth.comparison.rows import Row

_INTERVAL_MIN = 10.0


class RateOfGrowth(Case):
    """A sheet that grows faster and faster, looked at every ten minutes."""

    kind = "rate_of_growth"
    title = "Growth over growth"
    question = "How well is growth measured, over 20 px, at which rate?"
    varied = "growth rate of the area, % per hour, a frame every 10 minutes"
    full = (0.0, 1.0, 3.0, 10.0, 30.0)
    headline = ("growth_rate_windowed", "rms")
    quantities = ("velocity_z", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet that grows at this rate."""
        return growing_sheet(value / 100, _INTERVAL_MIN)

    def further_rows(self, found: Found) -> Iterable[Row]:
        """Return the errors of the growth rate over windows, in % per hour."""
        return growth_rows(self, found)

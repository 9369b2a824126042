"""The spatial resolution of depth: how much is left of a corrugated surface."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.resolution import crossing_rows, left_rows
from scenetruth.comparison.rows import Row
from scenetruth.comparison.sheet import sheet

_STEEPNESS = 1 / 15
"""Amplitude over period; slopes are below 23 degrees."""


class WavesOfDepth(Case):
    """A corrugated sheet with shorter and shorter waves."""

    kind = "waves_of_depth"
    title = "Resolution of depth"
    question = "Down to which period is a relief found, 10 % of its amplitude being lost at most?"
    varied = "period of the relief, px"
    core = (20.0, 32.0, 48.0, 96.0)
    full = (16.0, 20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("depth", "period_at_10_percent_loss_first")
    logarithmic = True
    quantities = ("depth", "disparity")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet with waves along Y, which cameras along X see alike."""
        relief = {
            "kind": "relief",
            "size_mm": [240, 200],
            "amplitude_mm": _STEEPNESS * value,
            "wavelength_mm": [None, value],
            "resolution_mm": 1.0,
        }
        # It is at rest: more frames would show the same.
        changes = {"objects.0.mesh": relief, "objects.0.motion": [], "frames.count": 3}
        return sheet(changes, baseline_mm=12.3)

    def noise_std(self, value: float) -> float:
        """Return none: what is lost is no noise."""
        return 0.0

    def further_rows(self, found: Found) -> Iterable[Row]:
        """Return the share of the relief that is left."""
        return left_rows(self, found, "depth")

    def conclusions(self, rows: Sequence[Row]) -> Iterable[Row]:
        """Return the periods at which the share crosses 90 %."""
        return crossing_rows(self, rows, "depth")

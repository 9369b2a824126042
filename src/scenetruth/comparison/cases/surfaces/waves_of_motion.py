"""The spatial resolution of motion: how much is left of waves of displacement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.resolution import crossing_rows, left_rows
from scenetruth.comparison.rows import Row
from scenetruth.comparison.sheet import sheet


class WavesOfMotion(Case):
    """A sheet whose points move up and down as a cosine across it."""

    kind = "waves_of_motion"
    title = "Resolution of motion"
    question = "Down to which period is a displacement found, 10 % of its amplitude being lost at most?"
    varied = "period of the displacement, px"
    core = (32.0, 48.0, 96.0)
    full = (16.0, 20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("flow_y", "period_at_10_percent_loss_first")
    logarithmic = True
    quantities = ("flow_y", "velocity_y")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet whose displacement is 0.2 px per frame at most."""
        wave = {"kind": "star", "amplitude_mm": {"kind": "linear", "rate_per_frame": 0.2}, "period_mm": [value, value]}
        changes = {"objects.0.motion": [], "objects.0.mesh.resolution_mm": 1.0, "objects.0.deformation": [wave]}
        return sheet(changes)

    def noise_std(self, value: float) -> float:
        """Return none: what is lost is no noise."""
        return 0.0

    def further_rows(self, found: Found) -> Iterable[Row]:
        """Return the share of the wave that is left."""
        return left_rows(self, found, "flow_y")

    def conclusions(self, rows: Sequence[Row]) -> Iterable[Row]:
        """Return the periods at which the share crosses 90 %."""
        return crossing_rows(self, rows, "flow_y")

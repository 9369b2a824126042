"""Steps of the stage that are not quite as long as stated."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.calibration_cause import CalibrationCause
from scenetruth.design.budget.propagation.base import Errors
from scenetruth.design.budget.sight import Sight


class Baseline(CalibrationCause):
    """Depth and all velocities are off by the same share; growth is not."""

    kind = "baseline"
    title = "baseline"
    field = "baseline_percent"
    unit = "%"
    signs = ("+-+-",)

    def responses_of(self, sight: Sight, *off: float) -> Iterator[Errors]:
        """Give the errors that a share makes."""
        share = off[0] / 100
        velocity = {f"velocity_{axis}": share * sight.velocity[k] for k, axis in enumerate("xyz")}
        yield {"depth": share * sight.depth, **velocity, "growth_rate": 0.0 * sight.depth}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change baseline and positions that the recording tells."""
        (drawn,) = self.drawn_values(draw)
        factor = 1 + calibration.baseline_percent / 100 * drawn
        recording.attrs["baseline_mm"] *= factor
        recording["stage_x_mm"] = recording["stage_x_mm"] * factor

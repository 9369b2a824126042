"""A focal length that is not quite right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import xarray as xr

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.calibration_cause import CalibrationCause
from scenetruth.design.budget.growth import growth_error
from scenetruth.design.budget.propagation.base import Errors
from scenetruth.design.budget.sight import Sight


class FocalLength(CalibrationCause):
    """Depth and U_Z are off by the same share; U_X and U_Y are not."""

    kind = "focal_length"
    title = "focal length"
    field = "focal_length_percent"
    unit = "%"
    signs = ("++--",)

    def responses_of(self, sight: Sight, *off: float) -> Iterator[Errors]:
        """Give the errors that a share makes."""
        share = off[0] / 100
        found = {"depth": share * sight.depth, "velocity_z": share * sight.velocity[2]}
        wrong = replace(sight.intrinsics, focal_length_px=sight.intrinsics.focal_length_px * (1 + share))
        yield {**found, "growth_rate": growth_error(sight, found, wrong)}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change the focal length that the recording tells."""
        (drawn,) = self.drawn_values(draw)
        recording.attrs["focal_length_px"] *= 1 + calibration.focal_length_percent / 100 * drawn

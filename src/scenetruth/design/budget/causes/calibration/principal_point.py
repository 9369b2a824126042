"""A principal point that is not quite right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import xarray as xr

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.calibration_cause import CalibrationCause
from scenetruth.design.budget.growth import growth_error
from scenetruth.design.budget.propagation.base import Errors
from scenetruth.design.budget.sight import Sight


class PrincipalPoint(CalibrationCause):
    """U_X and U_Y are off by the share of U_Z that a pixel's place stands for: δc U_Z / f."""

    kind = "principal_point"
    title = "principal point"
    field = "principal_point_px"
    unit = "px"
    signs = ("+--+", "+-")

    def responses_of(self, sight: Sight, *off: float) -> Iterator[Errors]:
        """Give the errors that a shift along x, and one along y, make."""
        c_x, c_y = sight.intrinsics.principal_point_px
        for k, one in enumerate(off):
            found = {
                "depth": 0.0 * sight.depth,
                "velocity_z": 0.0 * sight.depth,
                f"velocity_{'xy'[k]}": -one * sight.velocity[2] / sight.intrinsics.focal_length_px,
            }
            wrong = replace(sight.intrinsics, principal_point_px=(c_x + one * (k == 0), c_y + one * (k == 1)))
            yield {**found, "growth_rate": growth_error(sight, found, wrong)}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change the principal point that the recording tells."""
        point = np.asarray(recording.attrs["principal_point_px"], dtype=np.float64)
        point = point + calibration.principal_point_px * np.array(self.drawn_values(draw))
        recording.attrs["principal_point_px"] = point.tolist()

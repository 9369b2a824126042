"""The star of digital image correlation: the spatial resolution of motion over many periods, from one scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.comparison.case import Case, Found, Mask, inner
from scenetruth.comparison.measures.resolution import crossing_rows, left_rows
from scenetruth.comparison.rows import Row
from scenetruth.comparison.sheet import sheet, wall

_WIDTH_PX, _HEIGHT_PX = 384, 96
_MESH_MM = (_WIDTH_PX + 80.0, _HEIGHT_PX + 80.0)
_PERIODS_MM = (120.0, 4.0)
"""At the left and at the right edge of the sheet: it falls by 1 px in 4 px, from 110 px to 14 px within the image."""
_BELOW_PX = 12.0
"""Middle of the star below that of the image: on the optical axis a method may find more than anywhere else."""
_WITHIN = 0.1
"""Columns count to a period whose own differs by so much of it at most."""


class Star(Case):
    """A sheet that moves up and down as a cosine, whose period falls from left to right; its middle is measured."""

    kind = "star"
    title = "Star"
    question = "Along the middle of a star, down to which period is a displacement found but for 10 %?"
    varied = "period of the displacement, px"
    core = (20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("flow_y", "period_at_10_percent_loss_first")
    logarithmic = True
    quantities = ("flow_y", "velocity_y")
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the star, whose displacement is 0.2 px per frame at most."""
        star = wall(size_mm=_MESH_MM, centre_mm=(0.0, _BELOW_PX))
        star["mesh"]["resolution_mm"] = 1.0
        star["motion"] = []
        amplitude = {"kind": "linear", "rate_per_frame": 0.2}
        star["deformation"] = [{"kind": "star", "amplitude_mm": amplitude, "period_mm": list(_PERIODS_MM)}]
        return sheet(
            {"camera.width": _WIDTH_PX, "camera.height": _HEIGHT_PX, "stage.positions": 3, "objects": [star]},
        )

    def noise_std(self, value: float) -> float:
        """Return none: what is lost is no noise."""
        return 0.0

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels of nearly this period around the star's middle row, an eighth of it to either side."""
        y, x = np.mgrid[: truth.sizes["y"], : truth.sizes["x"]]
        # 1 px is 1 mm.
        along = (x - (truth.sizes["x"] - 1) / 2) / _MESH_MM[0] + 0.5
        period = _PERIODS_MM[0] + along * (_PERIODS_MM[1] - _PERIODS_MM[0])
        near = np.abs(period - value) <= _WITHIN * value
        middle = np.abs(y - (truth.sizes["y"] - 1) / 2 - _BELOW_PX) <= value / 8
        return np.asarray(np.isfinite(truth["depth"].values) & inner(truth, self.margin_px) & near & middle)

    def further_rows(self, found: Found) -> Iterable[Row]:
        """Return the share of the displacement that is left."""
        return left_rows(self, found, "flow_y", of_mean=True)

    def conclusions(self, rows: Sequence[Row]) -> Iterable[Row]:
        """Return the periods at which the share crosses 90 %."""
        return crossing_rows(self, rows, "flow_y")

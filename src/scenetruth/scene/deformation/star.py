"""The star of the DIC community: a displacement across the sheet whose period changes along it."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from scenetruth.model import Positive
from scenetruth.scene.deformation.base import DeformationModel, Surroundings
from scenetruth.scene.jets import Field
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Star"]


class Star(DeformationModel):
    """The star of the DIC community: displacement across the sheet, a cosine in Y whose period changes along X.

    V = amplitude_mm cos(2 π Y / p(X)), p linear from the left to the right edge (Reu et al. 2022, DIC Challenge 2.0).
    """

    in_the_flat: ClassVar[bool] = True

    kind: Literal["star"]
    """``star``."""
    amplitude_mm: TimeCurve
    """Largest displacement in mm."""
    period_mm: tuple[Positive, Positive]
    """Period p at the least and at the largest X of the mesh in mm."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map; see `DeformationModel`."""
        left, right = around.extent_mm
        at_left, at_right = self.period_mm
        slope = (at_right - at_left) / (right - left) if right > left else 0.0

        def displace(points: Points, t: Field) -> Points:
            x, y, z = points
            return x, y + value_at(self.amplitude_mm, t) * np.cos(2 * np.pi * y / (at_left + slope * (x - left))), z

        return displace

"""How deep space is that is sharp."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.model import Positive

__all__ = ["DepthOfField"]


class DepthOfField(Limit):
    """Depths whose blur disc is smaller than some pixels: f A |1/Z - 1/Z_f| < blur_px."""

    unit: ClassVar[str] = "mm"

    kind: Literal["depth_of_field"] = "depth_of_field"

    blur_px: Positive = 1.0
    """Diameter of the blur disc that is sharp enough."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return f"depth of field, discs under {self.blur_px:g} px"

    def value(self, facts: Facts) -> float:
        """Return the distance of the two depths; infinite if everything is sharp."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return math.inf
        reach = self.blur_px / (facts.scene.camera.focal_px * defocus.aperture_mm)
        middle = 1 / defocus.focus_distance_mm
        return math.inf if reach >= middle else 1 / (middle - reach) - 1 / (middle + reach)

"""Under which angle the outermost positions see a point."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["StereoAngle"]


class StereoAngle(Limit):
    """Angle between the rays from the outermost positions at the median depth of the first objective's region."""

    unit: ClassVar[str] = "°"

    kind: Literal["stereo_angle"] = "stereo_angle"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "angle between the outermost views"

    def value(self, facts: Facts) -> float:
        """Return the angle."""
        return math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))

"""Lamps that shine alike in all directions."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scenetruth.model import NonNegative, Positive, Vector3
from scenetruth.scene.light.base import EVERYWHERE, Lamp, LightModel, moved_axis
from scenetruth.scene.motions import Motion

__all__ = ["PointLight"]


class PointLight(LightModel):
    """A lamp that shines alike in all directions; irradiance falls with the square of the distance."""

    kind: Literal["point"]
    """``point``."""
    position_mm: Vector3
    """World position at t = 0 in mm."""
    irradiance: NonNegative
    """Irradiance E of a surface that faces the lamp at ``reference_distance_mm``."""
    reference_distance_mm: Positive
    """Distance from the lamp where ``irradiance`` holds."""
    motion: tuple[Motion, ...] = ()
    """How it moves; rotations without a point of their own turn about its position."""

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t; see `LightModel`."""
        at, _ = moved_axis(self.motion, self.position_mm, self.position_mm, t)
        return Lamp(at, np.zeros(3), self.irradiance, self.reference_distance_mm, EVERYWHERE, EVERYWHERE)

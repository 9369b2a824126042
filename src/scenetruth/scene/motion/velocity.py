"""Translation by a constant velocity."""

from __future__ import annotations

from typing import Literal

from scenetruth.model import Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points

__all__ = ["ConstantVelocity"]


class ConstantVelocity(MotionModel):
    """Translation by a constant velocity."""

    kind: Literal["velocity"]
    """``velocity``."""
    velocity_mm_per_frame: Vector3
    """(U_X, U_Y, U_Z) in mm per frame."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        velocity = self.velocity_mm_per_frame

        def move(points: Points, t: Field) -> Points:
            x, y, z = points
            return x + velocity[0] * t, y + velocity[1] * t, z + velocity[2] * t

        return move

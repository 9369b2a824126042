"""Translation by a velocity that changes steadily."""

from __future__ import annotations

from typing import Literal

from scenetruth.model import Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points

__all__ = ["Acceleration"]


class Acceleration(MotionModel):
    """Translation by a velocity that changes steadily: v t + a t² / 2."""

    kind: Literal["acceleration"]
    """``acceleration``."""
    velocity_mm_per_frame: Vector3 = (0.0, 0.0, 0.0)
    """Velocity v at t = 0 in mm per frame."""
    acceleration_mm_per_frame2: Vector3
    """Acceleration a in mm per frame squared."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        velocity, acceleration = self.velocity_mm_per_frame, self.acceleration_mm_per_frame2

        def move(points: Points, t: Field) -> Points:
            shifts = (v * t + (a / 2) * (t * t) for v, a in zip(velocity, acceleration, strict=True))
            x, y, z = (field + shift for field, shift in zip(points, shifts, strict=True))
            return x, y, z

        return move

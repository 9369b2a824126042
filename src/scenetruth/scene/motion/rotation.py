"""Rotation at a constant rate."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scenetruth.model import Direction, Finite, Vector3
from scenetruth.scene.motion.base import MotionModel, PointMap
from scenetruth.scene.motion.maps import turn

__all__ = ["ConstantRotation"]


class ConstantRotation(MotionModel):
    """Rotation about an axis through a point at a constant rate (right-hand rule)."""

    kind: Literal["rotation"]
    """``rotation``."""
    axis: Direction
    """Direction of the axis in the world frame."""
    rate_deg_per_frame: Finite
    """Angle per frame in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; the position of what moves if not given."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        rate = np.deg2rad(self.rate_deg_per_frame)
        return lambda points, t: turn(points, self.axis, rate * t, centre)

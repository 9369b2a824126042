"""Rotation in the own frame by an angle that follows a curve in time."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scenetruth.model import Direction, Vector3
from scenetruth.scene.deformation.base import DeformationModel, Surroundings
from scenetruth.scene.motion import PointMap
from scenetruth.scene.motion.maps import turn
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Hinge"]


class Hinge(DeformationModel):
    """Rotation about an axis in the object's own frame by an angle that changes: a leaf about its petiole."""

    kind: Literal["hinge"]
    """``hinge``."""
    axis: Direction = (0.0, 1.0, 0.0)
    """Direction of the axis in the own frame."""
    point_mm: Vector3 = (0.0, 0.0, 0.0)
    """Point on the axis in the own frame."""
    angle_deg: TimeCurve
    """Angle in degrees (right-hand rule)."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map; see `DeformationModel`."""
        return lambda points, t: turn(points, self.axis, np.pi / 180 * value_at(self.angle_deg, t), self.point_mm)

"""Rotation about an axis by an angle that follows a curve in time."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, model_validator

from scenetruth.model import Direction, Vector3
from scenetruth.scene.motion.base import MotionModel, PointMap
from scenetruth.scene.motion.maps import turn
from scenetruth.scene.motion.presets import TurnPreset, filled_in, preset_or_fields
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Turn"]


class Turn(MotionModel):
    """Rotation about an axis through a point by an angle that changes (right-hand rule): sway, if it is harmonic."""

    model_config = ConfigDict(json_schema_extra=preset_or_fields("axis"))

    kind: Literal["turn"]
    """``turn``."""
    preset: TurnPreset | None = None
    """A movement by name, whose values stand for all fields that are not given; null for none."""
    axis: Direction
    """Direction of the axis in the world frame."""
    angle_deg: TimeCurve
    """Angle in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; the position of what moves if not given."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return filled_in(given)

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        return lambda points, t: turn(points, self.axis, np.pi / 180 * value_at(self.angle_deg, t), centre)

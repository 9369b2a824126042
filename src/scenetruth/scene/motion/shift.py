"""Translation along a direction by a distance that follows a curve in time."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, model_validator

from scenetruth.model import Direction, Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points
from scenetruth.scene.motion.presets import ShiftPreset, filled_in, preset_or_fields
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Shift"]


class Shift(MotionModel):
    """Translation along a direction by a distance that changes: oscillation, if it is a harmonic curve."""

    model_config = ConfigDict(json_schema_extra=preset_or_fields("direction"))

    kind: Literal["shift"]
    """``shift``."""
    preset: ShiftPreset | None = None
    """A movement by name, whose values stand for all fields that are not given; null for none."""
    direction: Direction
    """Direction in the world frame, of any length."""
    distance_mm: TimeCurve
    """Distance along it in mm."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return filled_in(given)

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)

        def move(points: Points, t: Field) -> Points:
            distance = value_at(self.distance_mm, t)
            x, y, z = (field + n * distance for field, n in zip(points, direction, strict=True))
            return x, y, z

        return move

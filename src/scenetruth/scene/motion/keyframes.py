"""Translation and rotation through keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Described
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Finite, Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points
from scenetruth.scene.motion.maps import turn_by
from scenetruth.scene.motion.time_curve import SplineThrough, increasing

__all__ = ["Keyframes"]


class Keyframes(MotionModel):
    """Translation and rotation through keyframes: cubic splines, twice continuously differentiable."""

    kind: Literal["keyframes"]
    """``keyframes``."""
    times_frames: tuple[Finite, ...]
    """Times of the keyframes in frames, increasing; at least two."""
    positions_mm: Annotated[tuple[Vector3, ...] | None, Described(validate_default=True)] = None
    """Displacement in mm at each; null for none."""
    rotations_deg: Annotated[tuple[Vector3, ...] | None, Described(validate_default=True)] = None
    """Rotation vector (direction of the axis, its length the angle in degrees) at each; null for none.

    The splines go through the vectors' components. Rotation comes before translation.
    """
    point_mm: Vector3 | None = None
    """World point that rotations leave in place; the position of what moves if not given."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return increasing(value)

    @field_validator("positions_mm", "rotations_deg")
    @classmethod
    def _as_many(cls, value: tuple[Vector3, ...] | None, info: ValidationInfo) -> tuple[Vector3, ...] | None:
        times = info.data.get("times_frames")
        if value is not None and times is not None and len(value) != len(times):
            msg = f"needs one entry for each of times_frames: {len(value)} for {len(times)}"
            raise ValueError(msg)
        if info.field_name == "rotations_deg" and value is None and info.data.get("positions_mm", ()) is None:
            msg = "keyframes need positions_mm, rotations_deg or both"
            raise ValueError(msg)
        return value

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        shifts = _splines(self.times_frames, self.positions_mm, 1.0)
        turns = _splines(self.times_frames, self.rotations_deg, np.pi / 180)

        def move(points: Points, t: Field) -> Points:
            if turns:
                points = turn_by(points, (turns[0](t), turns[1](t), turns[2](t)), centre)
            if shifts:
                points = (points[0] + shifts[0](t), points[1] + shifts[1](t), points[2] + shifts[2](t))
            return points

        return move


def _splines(times: Sequence[float], values: Sequence[Vector3] | None, unit: float) -> list[SplineThrough]:
    if values is None:
        return []
    return [SplineThrough(times, column) for column in np.asarray(values, dtype=np.float64).T * unit]

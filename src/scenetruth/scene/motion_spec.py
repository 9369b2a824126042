"""The models of motions in the world, of objects and of lights."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from scenetruth.model import Direction, Finite, FrozenModel, Positive, Vector3
from scenetruth.scene.motion_presets import ShiftPreset, TurnPreset, filled_in, preset_or_fields
from scenetruth.scene.time_curve import TimeCurve, increasing

__all__ = [
    "Acceleration",
    "ConstantRotation",
    "ConstantVelocity",
    "Keyframes",
    "Motion",
    "Nutation",
    "Shift",
    "Turn",
]


class ConstantVelocity(FrozenModel):
    """Translation by a constant velocity."""

    kind: Literal["velocity"]
    """``velocity``."""
    velocity_mm_per_frame: Vector3
    """(U_X, U_Y, U_Z) in mm per frame."""


class ConstantRotation(FrozenModel):
    """Rotation about an axis through a point at a constant rate (right-hand rule)."""

    kind: Literal["rotation"]
    """``rotation``."""
    axis: Direction
    """Direction of the axis in the world frame."""
    rate_deg_per_frame: Finite
    """Angle per frame in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; the position of what moves if not given."""


class Acceleration(FrozenModel):
    """Translation by a velocity that changes steadily: v t + a t² / 2."""

    kind: Literal["acceleration"]
    """``acceleration``."""
    velocity_mm_per_frame: Vector3 = (0.0, 0.0, 0.0)
    """Velocity v at t = 0 in mm per frame."""
    acceleration_mm_per_frame2: Vector3
    """Acceleration a in mm per frame squared."""


class Shift(FrozenModel):
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


class Turn(FrozenModel):
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


class Nutation(FrozenModel):
    """Circumnutation: the tilt of an organ goes round, so that its tip draws an ellipse about its mean direction.

    The organ's direction d is tilted by the rotation vector a cos φ (d x e) + b sin φ (d x f), φ = 2 π t / period +
    phase, with e the part of ``towards`` perpendicular to d, and f = d x e.
    """

    kind: Literal["nutation"]
    """``nutation``."""
    direction: Direction
    """Mean direction d of the organ in the world frame, of any length."""
    towards: Vector3
    """Where the organ is tilted to at phase 0; from there it goes round d by the right-hand rule."""
    amplitudes_deg: tuple[Finite, Finite]
    """Tilts a and b in degrees; equal ones give a circle, one of them zero a sway."""
    period_frames: Positive
    """Frames of one round."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""
    point_mm: Vector3 | None = None
    """World point that rests; the position of what moves if not given."""

    @field_validator("towards")
    @classmethod
    def _aside(cls, value: tuple[float, float, float], info: ValidationInfo) -> tuple[float, float, float]:
        direction = info.data.get("direction")
        if direction is not None:
            lengths = np.linalg.norm(value) * np.linalg.norm(direction)
            if np.linalg.norm(np.cross(value, direction)) <= 1e-6 * lengths:
                msg = "must not be parallel to direction"
                raise ValueError(msg)
        return value


class Keyframes(FrozenModel):
    """Translation and rotation through keyframes: cubic splines, twice continuously differentiable."""

    kind: Literal["keyframes"]
    """``keyframes``."""
    times_frames: tuple[Finite, ...]
    """Times of the keyframes in frames, increasing; at least two."""
    positions_mm: Annotated[tuple[Vector3, ...] | None, Field(validate_default=True)] = None
    """Displacement in mm at each; null for none."""
    rotations_deg: Annotated[tuple[Vector3, ...] | None, Field(validate_default=True)] = None
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


Motion = Annotated[
    ConstantVelocity | ConstantRotation | Acceleration | Shift | Turn | Nutation | Keyframes,
    Field(discriminator="kind"),
]

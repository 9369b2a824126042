"""Rigid motions in the world, and the union of all motion types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, ValidationInfo, field_validator, model_validator
from pydantic import Field as Described

from scenetruth.discovery import discriminated_union
from scenetruth.scene.motion.motion_presets import ShiftPreset, TurnPreset, fill_in_preset, preset_or_fields
from scenetruth.scene.motion.point_maps import MotionModel, PointMap, Points, rotate_points, rotate_points_by_vector
from scenetruth.scene.motion.time_curve import SplineThrough, TimeCurve, check_increasing, evaluate_curve
from scenetruth.scene.taylor import JetField
from scenetruth.validated_model import Direction, Finite, Positive, Vector3

__all__ = [
    "ConstantAcceleration",
    "ConstantRotation",
    "ConstantVelocity",
    "Exponential",
    "Keyframes",
    "Motion",
    "Nutation",
    "RotationCurve",
    "TranslationCurve",
]


class ConstantAcceleration(MotionModel):
    """Translation with constant acceleration: v t + a t² / 2."""

    kind: Literal["acceleration"]
    """``acceleration``."""
    velocity_mm_per_frame: Vector3 = (0.0, 0.0, 0.0)
    """Velocity v at t = 0 in mm per frame."""
    acceleration_mm_per_frame2: Vector3
    """Acceleration a in mm per frame squared."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        velocity, acceleration = self.velocity_mm_per_frame, self.acceleration_mm_per_frame2

        def move(points: Points, t: JetField) -> Points:
            shifts = (v * t + (a / 2) * (t * t) for v, a in zip(velocity, acceleration, strict=True))
            x, y, z = (field + shift for field, shift in zip(points, shifts, strict=True))
            return x, y, z

        return move


def _not_zero(value: float) -> float:
    if value == 0:
        msg = "must not be zero: positive for growth, negative for relaxation"
        raise ValueError(msg)
    return value


class Exponential(MotionModel):
    """Translation with exponential growth or relaxation, as in elongation: amplitude (exp(t / time_constant) - 1)."""

    kind: Literal["exponential"]
    """``exponential``."""
    direction: Direction
    """Direction in the world frame, of any length."""
    amplitude_mm: Finite
    """Amplitude in mm: the distance after ln 2 time constants; relaxation converges to its negative."""
    time_constant_frames: Annotated[Finite, AfterValidator(_not_zero)]
    """Time in frames for a change by a factor e of the distance to the asymptote; negative for relaxation."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)

        def move(points: Points, t: JetField) -> Points:
            distance = self.amplitude_mm * np.expm1(t / self.time_constant_frames)
            x, y, z = (field + n * distance for field, n in zip(points, direction, strict=True))
            return x, y, z

        return move


class Keyframes(MotionModel):
    """Translation and rotation interpolated between keyframes by cubic splines, twice continuously differentiable."""

    kind: Literal["keyframes"]
    """``keyframes``."""
    times_frames: tuple[Finite, ...]
    """Times of the keyframes in frames, increasing; at least two."""
    positions_mm: Annotated[tuple[Vector3, ...] | None, Described(validate_default=True)] = None
    """Displacement in mm at each keyframe; null for none."""
    rotations_deg: Annotated[tuple[Vector3, ...] | None, Described(validate_default=True)] = None
    """Rotation vector (axis times angle in degrees) at each keyframe; null for none. The splines interpolate the vector
    components. Rotation precedes translation.
    """
    point_mm: Vector3 | None = None
    """World point fixed under rotations; default: the position of the object."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return check_increasing(value)

    @field_validator("positions_mm", "rotations_deg")
    @classmethod
    def _as_many(cls, value: tuple[Vector3, ...] | None, info: ValidationInfo) -> tuple[Vector3, ...] | None:
        times = info.data.get("times_frames")
        if value is not None and times is not None and len(value) != len(times):
            msg = f"requires one entry for each of times_frames: {len(value)} for {len(times)}"
            raise ValueError(msg)
        if info.field_name == "rotations_deg" and value is None and info.data.get("positions_mm", ()) is None:
            msg = "keyframes require positions_mm, rotations_deg or both"
            raise ValueError(msg)
        return value

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        shifts = _splines(self.times_frames, self.positions_mm, 1.0)
        turns = _splines(self.times_frames, self.rotations_deg, np.pi / 180)

        def move(points: Points, t: JetField) -> Points:
            if turns:
                points = rotate_points_by_vector(points, (turns[0](t), turns[1](t), turns[2](t)), centre)
            if shifts:
                points = (points[0] + shifts[0](t), points[1] + shifts[1](t), points[2] + shifts[2](t))
            return points

        return move


def _splines(times: Sequence[float], values: Sequence[Vector3] | None, unit: float) -> list[SplineThrough]:
    if values is None:
        return []
    return [SplineThrough(times, column) for column in np.asarray(values, dtype=np.float64).T * unit]


class Nutation(MotionModel):
    """Circumnutation: periodic tilt of an organ whose tip describes an ellipse about its mean direction.

    The organ direction d is tilted by the rotation vector a cos φ (d x e) + b sin φ (d x f), φ = 2 π t / period +
    phase, with e the part of ``towards`` perpendicular to d, and f = d x e.
    """

    kind: Literal["nutation"]
    """``nutation``."""
    direction: Direction
    """Mean direction d of the organ in the world frame, of any length."""
    towards: Vector3
    """Direction of the tilt at phase 0, from which it rotates about d by the right-hand rule."""
    amplitudes_deg: tuple[Finite, Finite]
    """Tilts a and b in degrees; equal values give a circle, a zero value gives a planar oscillation."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""
    point_mm: Vector3 | None = None
    """Fixed world point; default: the position of the object."""

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

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)
        partial = np.asarray(self.towards) - (direction @ np.asarray(self.towards)) * direction
        first = np.cross(direction, partial / np.linalg.norm(partial))
        second = np.cross(direction, first)
        amplitude_first, amplitude_second = np.deg2rad(self.amplitudes_deg)

        def move(points: Points, t: JetField) -> Points:
            phase = 2 * np.pi / self.period_frames * t + np.deg2rad(self.phase_deg)
            cosine, sine = amplitude_first * np.cos(phase), amplitude_second * np.sin(phase)
            u, v, w = (one * cosine + other * sine for one, other in zip(first, second, strict=True))
            return rotate_points_by_vector(points, (u, v, w), centre)

        return move


class ConstantRotation(MotionModel):
    """Rotation about an axis through a point at a constant rate (right-hand rule)."""

    kind: Literal["rotation"]
    """``rotation``."""
    axis: Direction
    """Direction of the axis in the world frame."""
    rate_deg_per_frame: Finite
    """Angle per frame in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; default: the position of the object."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        rate = np.deg2rad(self.rate_deg_per_frame)
        return lambda points, t: rotate_points(points, self.axis, rate * t, centre)


class TranslationCurve(MotionModel):
    """Translation along a direction by a time-dependent distance, for example a harmonic oscillation."""

    model_config = ConfigDict(json_schema_extra=preset_or_fields("direction"))

    kind: Literal["shift"]
    """``shift``."""
    preset: ShiftPreset | None = None
    """Preset that supplies the default values; null for none."""
    direction: Direction
    """Direction in the world frame, of any length."""
    distance_mm: TimeCurve
    """Distance along the direction in mm."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return fill_in_preset(given)

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)

        def move(points: Points, t: JetField) -> Points:
            distance = evaluate_curve(self.distance_mm, t)
            x, y, z = (field + n * distance for field, n in zip(points, direction, strict=True))
            return x, y, z

        return move


class RotationCurve(MotionModel):
    """Rotation about an axis through a point by a time-dependent angle (right-hand rule), such as an oscillation."""

    model_config = ConfigDict(json_schema_extra=preset_or_fields("axis"))

    kind: Literal["turn"]
    """``turn``."""
    preset: TurnPreset | None = None
    """Preset that supplies the default values; null for none."""
    axis: Direction
    """Direction of the axis in the world frame."""
    angle_deg: TimeCurve
    """Angle in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; default: the position of the object."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return fill_in_preset(given)

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        return lambda points, t: rotate_points(
            points, self.axis, np.pi / 180 * evaluate_curve(self.angle_deg, t), centre
        )


class ConstantVelocity(MotionModel):
    """Translation at constant velocity."""

    kind: Literal["velocity"]
    """``velocity``."""
    velocity_mm_per_frame: Vector3
    """(U_X, U_Y, U_Z) in mm per frame."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the point map, see `MotionModel`."""
        velocity = self.velocity_mm_per_frame

        def move(points: Points, t: JetField) -> Points:
            x, y, z = points
            return x + velocity[0] * t, y + velocity[1] * t, z + velocity[2] * t

        return move


if TYPE_CHECKING:
    Motion = MotionModel
else:
    Motion = discriminated_union(MotionModel, "scenetruth.scene.motion")

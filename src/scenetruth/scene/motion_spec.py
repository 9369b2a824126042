"""The models of motions, of objects and of lights."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.model import Finite, FrozenModel, Vector3

__all__ = ["ConstantRotation", "ConstantVelocity", "Motion", "nonzero"]


def nonzero(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse the zero vector, for fields that need a direction."""
    if not any(value):
        msg = "must not be the zero vector"
        raise ValueError(msg)
    return value


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
    axis: Vector3
    """Direction of the axis in the world frame."""
    rate_deg_per_frame: Finite
    """Angle per frame in degrees."""
    point_mm: Vector3 | None = None
    """World point on the axis; the position of what moves if not given."""

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        return nonzero(value)


Motion = Annotated[ConstantVelocity | ConstantRotation, Field(discriminator="kind")]

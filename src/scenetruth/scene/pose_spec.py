"""Where objects stand."""

from __future__ import annotations

from pydantic import field_validator

from scenetruth.model import Finite, FrozenModel, Vector3
from scenetruth.scene.motion_spec import nonzero

__all__ = ["Pose", "Rotation"]


class Rotation(FrozenModel):
    """A rotation about an axis through the object's origin (right-hand rule: X towards Y about Z)."""

    axis: Vector3
    """Direction of the axis."""
    angle_deg: Finite
    """Angle in degrees."""

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        return nonzero(value)


class Pose(FrozenModel):
    """Where an object stands at t = 0: rotated first, in the given order, then moved to its position."""

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    """World position of the mesh's origin in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations about fixed axes, applied one after the other."""

"""Where objects stand."""

from __future__ import annotations

from scenetruth.model import Direction, Finite, FrozenModel, Vector3

__all__ = ["Pose", "Rotation"]


class Rotation(FrozenModel):
    """A rotation about an axis through the object's origin (right-hand rule: X towards Y about Z)."""

    axis: Direction
    """Direction of the axis."""
    angle_deg: Finite
    """Angle in degrees."""


class Pose(FrozenModel):
    """Where an object stands at t = 0: rotated first, in the given order, then moved to its position."""

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    """World position of the mesh's origin in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations about fixed axes, applied one after the other."""

"""The models of deformations: motions within an object's own frame, before it is posed."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from scenetruth.model import FrozenModel, Vector3
from scenetruth.scene.motion_spec import nonzero
from scenetruth.scene.time_curve import TimeCurve

__all__ = ["Deformation", "DeformationModel", "Hinge"]


class DeformationModel(FrozenModel):
    """What all deformations share."""

    in_the_flat: ClassVar[bool] = False
    """Whether it acts on the flat of a sheet (a leaf's blade), before the sheet takes its shape."""


class Hinge(DeformationModel):
    """Rotation about an axis in the object's own frame by an angle that changes: a leaf about its petiole."""

    kind: Literal["hinge"]
    """``hinge``."""
    axis: Vector3 = (0.0, 1.0, 0.0)
    """Direction of the axis in the own frame."""
    point_mm: Vector3 = (0.0, 0.0, 0.0)
    """Point on the axis in the own frame."""
    angle_deg: TimeCurve
    """Angle in degrees (right-hand rule)."""

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        return nonzero(value)


Deformation = Annotated[Hinge, Field()]

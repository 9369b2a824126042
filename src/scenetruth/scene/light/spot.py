"""Lamps that shine into a cone."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from scenetruth.model import Direction, NonNegative, Positive, Vector3
from scenetruth.scene.light.base import Lamp, LightModel, moved_axis
from scenetruth.scene.motions import Motion

__all__ = ["SpotLight"]


class SpotLight(LightModel):
    """A lamp that shines into a cone with a soft border; inside, as a point light."""

    kind: Literal["spot"]
    """``spot``."""
    position_mm: Vector3
    """World position at t = 0 in mm."""
    direction: Direction | None = None
    """Direction of the cone's axis at t = 0, of any length; give this or ``target_mm``."""
    target_mm: Vector3 | None = None
    """World point on the cone's axis at t = 0; it moves along with the lamp, as one rigid body."""
    inner_angle_deg: Annotated[float, Field(ge=0, le=180, allow_inf_nan=False)]
    """Angle from the axis up to which the lamp shines in full."""
    outer_angle_deg: Annotated[float, Field(gt=0, le=180, allow_inf_nan=False)]
    """Angle from the axis beyond which it is dark; in between, a smoothstep of the angle's cosine."""
    irradiance: NonNegative
    """Irradiance E of a surface that faces the lamp, in the full cone, at ``reference_distance_mm``."""
    reference_distance_mm: Positive
    """Distance from the lamp where ``irradiance`` holds."""
    motion: tuple[Motion, ...] = ()
    """How position and axis move; rotations without a point of their own turn about its position."""

    @field_validator("outer_angle_deg")
    @classmethod
    def _outside(cls, value: float, info: ValidationInfo) -> float:
        inner = info.data.get("inner_angle_deg")
        if inner is not None and value < inner:
            msg = f"must not be less than inner_angle_deg, {inner:g}"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _one_axis(self) -> SpotLight:
        if (self.direction is None) == (self.target_mm is None):
            msg = "give either direction or target_mm"
            raise ValueError(msg)
        if self.target_mm == self.position_mm:
            msg = "target_mm must not be the lamp's own position: the cone would have no axis"
            raise ValueError(msg)
        return self

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t; see `LightModel`."""
        at = np.asarray(self.position_mm)
        ahead = at + np.asarray(self.direction) if self.target_mm is None else np.asarray(self.target_mm)
        at, axis = moved_axis(self.motion, self.position_mm, (ahead[0], ahead[1], ahead[2]), t)
        inner, outer = np.cos(np.deg2rad([self.inner_angle_deg, self.outer_angle_deg]))
        return Lamp(at, axis, self.irradiance, self.reference_distance_mm, float(inner), float(outer))

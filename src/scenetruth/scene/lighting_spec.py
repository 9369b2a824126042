"""The models of the light on a scene: ambient, lamps that may move, shadows, and how brightness changes in time."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from scenetruth.model import Direction, Finite, FrozenModel, NonNegative, Positive, Vector3
from scenetruth.scene.motions import Motion

__all__ = ["DirectionalLight", "Flicker", "Light", "Lighting", "PointLight", "SpotLight"]


class DirectionalLight(FrozenModel):
    """Parallel light from infinitely far away."""

    kind: Literal["directional"]
    """``directional``."""
    direction: Direction
    """Direction in which the light travels at t = 0, of any length."""
    irradiance: NonNegative
    """Irradiance E of a surface that faces the light; 1 makes a surface as bright as its texture says."""
    motion: tuple[Motion, ...] = ()
    """How it moves; only rotations change it."""


class PointLight(FrozenModel):
    """A lamp that shines alike in all directions; irradiance falls with the square of the distance."""

    kind: Literal["point"]
    """``point``."""
    position_mm: Vector3
    """World position at t = 0 in mm."""
    irradiance: NonNegative
    """Irradiance E of a surface that faces the lamp at ``reference_distance_mm``."""
    reference_distance_mm: Positive
    """Distance from the lamp where ``irradiance`` holds."""
    motion: tuple[Motion, ...] = ()
    """How it moves; rotations without a point of their own turn about its position."""


class SpotLight(FrozenModel):
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


Light = Annotated[DirectionalLight | PointLight | SpotLight, Field(discriminator="kind")]


class Flicker(FrozenModel):
    """A periodic change of brightness, as of lamps on the mains."""

    amplitude: Annotated[float, Field(ge=0, lt=1)]
    """Amplitude, relative to the mean brightness."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""


class Lighting(FrozenModel):
    """The light on the objects.

    A surface has the radiance ``texture (ambient + sum of E falloff max(0, n l) over the lights that reach it)``, with
    its texture as albedo; π is left out, so that irradiance 1 gives the texture's own value. Everything that is seen is
    then multiplied by the brightness of the time. Without ambient and lights, the scene is unlit: radiance is the
    texture's, times the brightness.
    """

    ambient: NonNegative | None = None
    """Irradiance that comes from everywhere alike; 0 if there are lights, unlit if there are none either."""
    lights: tuple[Light, ...] = ()
    """The lamps."""
    shadows: bool = True
    """Whether objects take light from what is behind them."""
    drift_per_frame: Finite = 0.0
    """Brightness at time t is 1 + drift_per_frame t + flicker, of all that is seen, background included."""
    flicker: Flicker | None = None
    """A periodic part of it: amplitude sin(2π t / period + phase)."""

    @property
    def lit(self) -> bool:
        """Whether surfaces are shaded at all."""
        return self.ambient is not None or bool(self.lights)

    def brightness(self, t: float) -> float:
        """Return the factor of everything that is seen at time t (in frames); exactly 1 where nothing changes."""
        factor = 1.0 + self.drift_per_frame * t
        if self.flicker is not None:
            phase = 2 * np.pi * t / self.flicker.period_frames + np.deg2rad(self.flicker.phase_deg)
            factor += self.flicker.amplitude * float(np.sin(phase))
        return factor

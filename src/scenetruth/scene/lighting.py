"""Lighting of a scene: ambient light, moving lamps, shadows, and brightness variation over time."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from scenetruth.bands import BandNonNegative, as_number
from scenetruth.discovery import discriminated_union
from scenetruth.scene.motion import MotionModel, Points
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.validated_model import Direction, Finite, FrozenModel, Positive, Vector3

__all__ = ["EVERYWHERE", "DirectionalLight", "Flicker", "Lamp", "LightModel", "Lighting", "PointLight", "SpotLight"]


EVERYWHERE = -1.0
"""Cone-border cosine of a lamp without a cone."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """One light at one time.

    ``position_mm``: World position, shape (3,); None at infinity.
    ``axis``: Unit vector of the light direction, shape (3,); zeros for a point light.
    ``irradiance``: E at normal incidence at ``reference_distance_mm``, which is 0 for a directional light.
    ``cos_inner``, ``cos_outer``: Cosines of the inner and outer cone angles of a spotlight; -1 and -1 for other lights.
    """

    position_mm: NDArray[np.float64] | None
    axis: NDArray[np.float64]
    irradiance: float
    reference_distance_mm: float
    cos_inner: float
    cos_outer: float


class LightModel(FrozenModel):
    """Base class of lights."""

    kind: str
    """Type of the light."""

    @abstractmethod
    def lamp(self, t: float) -> Lamp:
        """Return the light at time t (in frames)."""


def moved_axis(
    motions: tuple[MotionModel, ...], at: Vector3, ahead: Vector3, t: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the position, mm, and axis unit vector (zero if undefined) of a lamp after rigid motion at time t."""
    position: Any = tuple(float(value) for value in at)
    time = np.array([float(t)])
    both = np.array([at, ahead], dtype=np.float64)
    points: Points = (both[:, 0], both[:, 1], both[:, 2])
    for motion in motions:
        points = motion.point_map(position)(points, time)
    here, there = np.column_stack([np.broadcast_to(field, (2,)) for field in points])
    axis = there - here
    return here, axis / max(float(np.linalg.norm(axis)), 1e-300)


class DirectionalLight(LightModel):
    """Parallel light from infinity."""

    kind: Literal["directional"]
    """``directional``."""
    direction: Direction
    """Propagation direction at t = 0, of any length."""
    irradiance: BandNonNegative
    """Irradiance E at normal incidence, for all bands or for each; 1 gives the radiance of the texture."""
    motion: tuple[Motion, ...] = ()
    """Motion of the light; only rotations have an effect."""

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        _, axis = moved_axis(self.motion, (0.0, 0.0, 0.0), self.direction, t)
        return Lamp(None, axis, as_number(self.irradiance), 0.0, EVERYWHERE, EVERYWHERE)


class PointLight(LightModel):
    """Isotropic point light with inverse-square falloff."""

    kind: Literal["point"]
    """``point``."""
    position_mm: Vector3
    """World position at t = 0 in mm."""
    irradiance: BandNonNegative
    """Irradiance E at normal incidence at ``reference_distance_mm``, for all bands or for each."""
    reference_distance_mm: Positive
    """Distance from the lamp at which ``irradiance`` is specified."""
    motion: tuple[Motion, ...] = ()
    """Motion of the lamp; rotations without a specified point are about its position."""

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        at, _ = moved_axis(self.motion, self.position_mm, self.position_mm, t)
        return Lamp(at, np.zeros(3), as_number(self.irradiance), self.reference_distance_mm, EVERYWHERE, EVERYWHERE)


class SpotLight(LightModel):
    """Point light restricted to a cone with a soft border."""

    kind: Literal["spot"]
    """``spot``."""
    position_mm: Vector3
    """World position at t = 0 in mm."""
    direction: Direction | None = None
    """Direction of the cone axis at t = 0, of any length; alternative to ``target_mm``."""
    target_mm: Vector3 | None = None
    """World point on the cone axis at t = 0; it moves rigidly with the lamp."""
    inner_angle_deg: Annotated[float, Field(ge=0, le=180, allow_inf_nan=False)]
    """Angle from the axis up to which the intensity is constant."""
    outer_angle_deg: Annotated[float, Field(gt=0, le=180, allow_inf_nan=False)]
    """Angle from the axis beyond which the intensity is zero; smoothstep of the cosine in between."""
    irradiance: BandNonNegative
    """Irradiance E at normal incidence inside the inner cone, at ``reference_distance_mm``, for all bands or for each.
    """
    reference_distance_mm: Positive
    """Distance from the lamp at which ``irradiance`` is specified."""
    motion: tuple[Motion, ...] = ()
    """Motion of position and axis; rotations without a specified point are about its position."""

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
            msg = "specify either direction or target_mm"
            raise ValueError(msg)
        if self.target_mm == self.position_mm:
            msg = "target_mm must differ from position_mm: the cone would have no axis"
            raise ValueError(msg)
        return self

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        at = np.asarray(self.position_mm)
        ahead = at + np.asarray(self.direction) if self.target_mm is None else np.asarray(self.target_mm)
        at, axis = moved_axis(self.motion, self.position_mm, (ahead[0], ahead[1], ahead[2]), t)
        inner, outer = np.cos(np.deg2rad([self.inner_angle_deg, self.outer_angle_deg]))
        return Lamp(at, axis, as_number(self.irradiance), self.reference_distance_mm, float(inner), float(outer))


if TYPE_CHECKING:
    Light = LightModel
else:
    Light = discriminated_union(LightModel, "scenetruth.scene.lighting")


class Flicker(FrozenModel):
    """Periodic brightness variation, such as that of mains-powered lamps."""

    amplitude: Annotated[float, Field(ge=0, lt=1)]
    """Amplitude, relative to the mean brightness."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""


class Lighting(FrozenModel):
    """Lighting of the objects.

    A surface has the radiance ``texture (ambient + sum of E falloff max(0, n l) over the lights that reach it)``, with
    the texture as albedo; the factor 1/π is omitted, so irradiance 1 gives the value of the texture. All radiances are
    then multiplied by the time-dependent brightness. Without ambient light and lights, the scene is unlit: radiance is
    texture times brightness.
    """

    ambient: BandNonNegative | None = None
    """Ambient irradiance, for all bands or for each; null: 0 with lights, unlit without lights."""
    lights: tuple[Light, ...] = ()
    """The lamps."""
    shadows: bool = True
    """Whether objects cast shadows."""
    drift_per_frame: Finite = 0.0
    """Linear brightness drift: brightness at time t is 1 + drift_per_frame t + flicker, including the background."""
    flicker: Flicker | None = None
    """Periodic brightness variation: amplitude sin(2π t / period + phase)."""

    @property
    def lit(self) -> bool:
        """Whether surfaces are shaded."""
        return self.ambient is not None or bool(self.lights)

    @property
    def ambient_irradiance(self) -> float:
        """Ambient irradiance, 0 for none; requires lighting restricted to one band."""
        return as_number(self.ambient or 0.0)

    def brightness(self, t: float) -> float:
        """Return the brightness factor at time t (in frames); exactly 1 without variation."""
        factor = 1.0 + self.drift_per_frame * t
        if self.flicker is not None:
            phase = 2 * np.pi * t / self.flicker.period_frames + np.deg2rad(self.flicker.phase_deg)
            factor += self.flicker.amplitude * float(np.sin(phase))
        return factor

    def lamps_at(self, t: float) -> list[Lamp]:
        """Return the lights at time t (in frames), in scene order."""
        return [light.lamp(t) for light in self.lights]

"""Lighting of a scene: ambient light, moving lamps, shadows, and brightness variation over time."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from scenetruth.bands import BandNonNegative, as_number
from scenetruth.discovery import discriminated_union
from scenetruth.input_files import InputFile
from scenetruth.scene.light_distribution import LightDistribution, load_distribution
from scenetruth.scene.motion import MotionModel, Points
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.validated_model import Direction, Finite, FrozenModel, NonNegative, Positive, Vector3

__all__ = [
    "EVERYWHERE",
    "DirectionalLight",
    "DiscLight",
    "Flicker",
    "IesLight",
    "Lamp",
    "LampArea",
    "LampBeam",
    "LightModel",
    "Lighting",
    "PointLight",
    "RectangleLight",
    "RingLight",
    "SphereLight",
    "SpotLight",
]


EVERYWHERE = -1.0
"""Cone-border cosine of a lamp without a cone."""
_THIN = 1e-6  # distance from a flat lamp, relative to its size, below which a point is on it
_TINY = 1e-100  # in place of a step of 0
_PARALLEL = 1e-6  # length below which the width of a lamp is parallel to its axis


@dataclass(frozen=True, eq=False)
class LampArea:
    """Size of a lamp; every part of it has the same radiance in all directions of its front.

    ``shape``: ``round`` (discs and rings), ``rectangle`` or ``sphere``.
    ``across``, ``down``: Unit vectors, shape (3,) each, at right angles to the axis of the lamp.
    ``sizes_mm``: Inner and outer radius, or half the width and half the height.
    ``radiance``: In units in which irradiance 1 gives the value of the texture.
    """

    shape: Literal["round", "rectangle", "sphere"]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    sizes_mm: tuple[float, float]
    radiance: float


@dataclass(frozen=True, eq=False)
class LampBeam:
    """Distribution of the light of a lamp without a size.

    ``across``, ``down``: Unit vectors of the horizontal angles 0 and 90°, shape (3,) each, at right angles to the axis.
    """

    distribution: LightDistribution
    across: NDArray[np.float64]
    down: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lamp:
    """One light at one time.

    ``position_mm``: World position, shape (3,); None at infinity.
    ``axis``: Unit vector of the light direction, shape (3,); zeros for a point light.
    ``irradiance``: E at normal incidence at ``reference_distance_mm``, which is 0 for a directional light.
    ``cos_inner``, ``cos_outer``: Cosines of the inner and outer cone angles of a spotlight; -1 and -1 for other lights.
    ``area``: None for lamps without a size. ``beam``: None for lamps without a photometric file.
    """

    position_mm: NDArray[np.float64] | None
    axis: NDArray[np.float64]
    irradiance: float
    reference_distance_mm: float
    cos_inner: float
    cos_outer: float
    area: LampArea | None = None
    beam: LampBeam | None = None

    @property
    def directed(self) -> bool:
        """Whether the light of a lamp without a size differs between directions."""
        return self.cos_inner > EVERYWHERE or self.beam is not None

    def relative_intensity(self, to_light: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the intensity of the beam towards points, relative to its maximum; without a beam, 1.

        ``to_light``: Unit vectors from the points towards the lamp, shape (n, 3).
        """
        if self.beam is None:
            return np.ones(len(to_light))
        along, across, down = (-(to_light @ vector) for vector in (self.axis, self.beam.across, self.beam.down))
        vertical, horizontal = np.arctan2(np.hypot(across, down), along), np.arctan2(down, across)
        return self.beam.distribution.at(np.rad2deg(vertical), np.rad2deg(horizontal))

    def outline_mm(self) -> NDArray[np.float64]:
        """Return points of the lamp, shape (n, 3): its centre unless it is a ring, and points on its outline."""
        assert self.position_mm is not None
        if self.area is None:
            return self.position_mm[None]
        inner, outer = self.area.sizes_mm
        if self.area.shape == "sphere":
            return self.position_mm + outer * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
        if self.area.shape == "rectangle":
            places = np.array([(0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]) * self.area.sizes_mm
        else:
            angles = 2 * np.pi * np.arange(16) / 16
            around = np.column_stack([np.cos(angles), np.sin(angles)])
            places = np.concatenate([inner * around[: None if inner > 0 else 1], outer * around])
        return np.asarray(self.position_mm + places @ np.stack([self.area.across, self.area.down]))

    def contains(self, point_mm: NDArray[np.float64]) -> bool:
        """Return whether a point lies within a lamp with a size, or on it."""
        if self.area is None or self.position_mm is None:
            return False
        away, (inner, outer) = point_mm - self.position_mm, self.area.sizes_mm
        if self.area.shape == "sphere":
            return float(np.linalg.norm(away)) <= outer
        if abs(float(away @ self.axis)) > _THIN * outer:
            return False
        across, down = abs(float(away @ self.area.across)), abs(float(away @ self.area.down))
        if self.area.shape == "rectangle":
            return across <= inner and down <= outer
        return inner <= float(np.hypot(across, down)) <= outer

    def distance_mm(self, corners_mm: NDArray[np.float64]) -> float:
        """Return the distance of triangles, shape (n, 3, 3), from the position of the lamp; infinite without one."""
        return np.inf if self.position_mm is None else float(_distance_from_origin(corners_mm - self.position_mm).min())

    def is_crossed_by(self, corners_mm: NDArray[np.float64]) -> bool:
        """Return whether any of the triangles, shape (n, 3, 3), passes through a lamp with a size."""
        if self.area is None or self.position_mm is None:
            return False
        away, (inner, outer) = corners_mm - self.position_mm, self.area.sizes_mm
        if self.area.shape == "sphere":
            return bool((_distance_from_origin(away) < (1 - _THIN) * outer).any())
        height = away @ self.axis
        cut = away[(height.min(axis=1) < -_THIN * outer) & (height.max(axis=1) > _THIN * outer)]
        for triangle in cut @ np.stack([self.area.across, self.area.down, self.axis], axis=1):
            # Where two of the sides pass through the plane of the lamp.
            sides = [(one, other) for one, other in zip(triangle, np.roll(triangle, 1, axis=0), strict=True)]
            begin, end = (
                one[:2] + one[2] / (one[2] - other[2]) * (other[:2] - one[:2])
                for one, other in sides
                if (one[2] > 0) != (other[2] > 0)
            )
            step = end - begin
            if self.area.shape == "rectangle":
                if _enters_rectangle(begin, step, np.array(self.area.sizes_mm)):
                    return True
                continue
            share = float(np.clip(-begin @ step / max(float(step @ step), 1e-300), 0, 1))
            nearest, farthest = np.linalg.norm(begin + share * step), max(np.linalg.norm(begin), np.linalg.norm(end))
            if nearest < outer and farthest > inner:
                return True
        return False


def _enters_rectangle(begin: NDArray[np.float64], step: NDArray[np.float64], half: NDArray[np.float64]) -> bool:
    """Return whether a line from a place on, by a step, enters a rectangle of half a width and height."""
    step = np.where(np.abs(step) < _TINY, _TINY, step)
    bounds = np.stack([(-half - begin) / step, (half - begin) / step])
    return max(float(bounds.min(axis=0).max()), 0.0) < min(float(bounds.max(axis=0).min()), 1.0)


def _distance_from_origin(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of triangles, shape (n, 3, 3), from the origin, shape (n,)."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    lengths = np.maximum(np.einsum("nck,nck->nc", sides, sides), 1e-300)
    shares = np.clip(-np.einsum("nck,nck->nc", triangles, sides) / lengths, 0, 1)
    on_sides = np.linalg.norm(triangles + shares[..., None] * sides, axis=2).min(axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    size = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    height = np.einsum("nk,nk->n", triangles[:, 0], normals) / size
    turns = np.einsum("nck,nk->nc", np.cross(triangles, np.roll(triangles, -1, axis=1)), normals)
    over = (turns > 0).all(axis=1)
    return np.asarray(np.where(over, np.abs(height), on_sides))


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


def _facing(
    at: Vector3, direction: Direction | None, target: Vector3 | None, motions: tuple[MotionModel, ...], t: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and axis at time t of a lamp with a direction or a target."""
    ahead = np.asarray(at) + np.asarray(direction) if target is None else np.asarray(target)
    return moved_axis(motions, at, (ahead[0], ahead[1], ahead[2]), t)


def _side_axis(
    at: Vector3, side: Direction, motions: tuple[MotionModel, ...], axis: NDArray[np.float64], t: float
) -> NDArray[np.float64]:
    """Return the unit vector at right angles to the axis at time t, towards a direction at t = 0."""
    ahead = np.asarray(at) + np.asarray(side)
    _, across = moved_axis(motions, at, (ahead[0], ahead[1], ahead[2]), t)
    across = across - (across @ axis) * axis
    return np.asarray(across / max(float(np.linalg.norm(across)), 1e-300))


def _require_axis(at: Vector3, direction: Direction | None, target: Vector3 | None) -> None:
    if (direction is None) == (target is None):
        msg = "specify either direction or target_mm"
        raise ValueError(msg)
    if target == at:
        msg = "target_mm must differ from position_mm: the lamp would face nowhere"
        raise ValueError(msg)


def _require_side(axis: NDArray[np.float64], side: Direction, name: str) -> None:
    if not float(np.linalg.norm(np.cross(axis, side))) > _PARALLEL * float(np.linalg.norm(side)):
        msg = f"{name} must not be parallel to the axis of the lamp"
        raise ValueError(msg)


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


class IesLight(LightModel):
    """Point light with the angular distribution of a photometric file (IESNA LM-63)."""

    kind: Literal["ies"]
    """``ies``."""
    file: InputFile
    """Path of the IES file: photometry of type C, ``TILT=NONE``; relative paths refer to the directory of the scene
    file. The intensity is bilinear between the angles of the file, and relative to its maximum.
    """
    position_mm: Vector3
    """World position at t = 0 in mm."""
    direction: Direction | None = None
    """Direction of the vertical angle 0 at t = 0, of any length; alternative to ``target_mm``."""
    target_mm: Vector3 | None = None
    """World point in the direction of the vertical angle 0 at t = 0."""
    zero_direction: Direction = (1.0, 0.0, 0.0)
    """Direction of the horizontal angle 0 at t = 0; its part at right angles to the axis counts. Horizontal angles
    increase counter-clockwise, as seen from behind the lamp along the axis.
    """
    irradiance: BandNonNegative
    """Irradiance E at normal incidence at ``reference_distance_mm``, in the direction of the maximum intensity, for all
    bands or for each.
    """
    reference_distance_mm: Positive
    """Distance from the lamp at which ``irradiance`` is specified."""
    motion: tuple[Motion, ...] = ()
    """Motion of position and axes; rotations without a specified point are about its position."""

    @model_validator(mode="after")
    def _axes(self) -> Self:
        _require_axis(self.position_mm, self.direction, self.target_mm)
        _require_side(self._facing(0.0)[1], self.zero_direction, "zero_direction")
        return self

    def _facing(self, t: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return _facing(self.position_mm, self.direction, self.target_mm, self.motion, t)

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`; raises a SceneError for a file that cannot be read."""
        at, axis = self._facing(t)
        across = _side_axis(self.position_mm, self.zero_direction, self.motion, axis, t)
        beam = LampBeam(load_distribution(Path(self.file)), across, np.cross(across, axis))
        irradiance = as_number(self.irradiance)
        return Lamp(at, axis, irradiance, self.reference_distance_mm, EVERYWHERE, EVERYWHERE, beam=beam)


class _FlatLight(LightModel):
    """Base class of flat lamps, which emit equal radiance into the half space in front of them (Lambert)."""

    position_mm: Vector3
    """World position of the centre at t = 0 in mm."""
    direction: Direction | None = None
    """Direction in which the lamp faces at t = 0, of any length; alternative to ``target_mm``."""
    target_mm: Vector3 | None = None
    """World point that the lamp faces at t = 0."""
    irradiance: BandNonNegative
    """Irradiance E at normal incidence on the axis, at ``reference_distance_mm`` from the centre."""
    reference_distance_mm: Positive
    """Distance from the lamp at which ``irradiance`` is specified."""
    motion: tuple[Motion, ...] = ()
    """Motion of the lamp; rotations without a specified point are about its position."""

    @model_validator(mode="after")
    def _one_axis(self) -> Self:
        _require_axis(self.position_mm, self.direction, self.target_mm)
        return self

    def _facing(self, t: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position and axis at time t."""
        return _facing(self.position_mm, self.direction, self.target_mm, self.motion, t)

    def _round(self, t: float, inner_mm: float, outer_mm: float) -> Lamp:
        """Return a disc or ring at time t."""
        at, axis = self._facing(t)
        across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        across /= max(float(np.linalg.norm(across)), 1e-300)
        shares = [radius**2 / (radius**2 + self.reference_distance_mm**2) for radius in (inner_mm, outer_mm)]
        radiance = as_number(self.irradiance) / (np.pi * (shares[1] - shares[0]))
        area = LampArea("round", across, np.cross(axis, across), (inner_mm, outer_mm), radiance)
        return Lamp(at, axis, as_number(self.irradiance), self.reference_distance_mm, EVERYWHERE, EVERYWHERE, area)


class DiscLight(_FlatLight):
    """Flat, round lamp."""

    kind: Literal["disc"]
    """``disc``."""
    radius_mm: Positive
    """Radius."""

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        return self._round(t, 0.0, self.radius_mm)


class RingLight(_FlatLight):
    """Flat, ring-shaped lamp, such as those around a lens."""

    kind: Literal["ring"]
    """``ring``."""
    inner_radius_mm: NonNegative
    """Radius of the opening."""
    radius_mm: Positive
    """Outer radius."""

    @field_validator("radius_mm")
    @classmethod
    def _outside(cls, value: float, info: ValidationInfo) -> float:
        inner = info.data.get("inner_radius_mm")
        if inner is not None and value <= inner:
            msg = f"must be greater than inner_radius_mm, {inner:g}"
            raise ValueError(msg)
        return value

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        return self._round(t, self.inner_radius_mm, self.radius_mm)


class RectangleLight(_FlatLight):
    """Flat, rectangular lamp, such as a panel."""

    kind: Literal["rectangle"]
    """``rectangle``."""
    size_mm: tuple[Positive, Positive]
    """Width and height."""
    width_direction: Direction = (1.0, 0.0, 0.0)
    """Direction of the width at t = 0; its part at right angles to the axis counts."""

    @model_validator(mode="after")
    def _width(self) -> Self:
        _require_side(self._facing(0.0)[1], self.width_direction, "width_direction")
        return self

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        at, axis = self._facing(t)
        across = _side_axis(self.position_mm, self.width_direction, self.motion, axis, t)
        width, height = self.size_mm
        x, y = (side / (2 * self.reference_distance_mm) for side in (width, height))
        x_far, y_far = np.hypot(1, x), np.hypot(1, y)
        whole = 2 * (x / x_far * np.arctan(y / x_far) + y / y_far * np.arctan(x / y_far))
        area = LampArea(
            "rectangle",
            across,
            np.cross(axis, across),
            (width / 2, height / 2),
            as_number(self.irradiance) / float(whole),
        )
        return Lamp(at, axis, as_number(self.irradiance), self.reference_distance_mm, EVERYWHERE, EVERYWHERE, area)


class SphereLight(LightModel):
    """Spherical lamp, which emits equal radiance in all directions."""

    kind: Literal["sphere"]
    """``sphere``."""
    position_mm: Vector3
    """World position of the centre at t = 0 in mm."""
    radius_mm: Positive
    """Radius."""
    irradiance: BandNonNegative
    """Irradiance E at normal incidence at ``reference_distance_mm`` from the centre."""
    reference_distance_mm: Positive
    """Distance from the centre at which ``irradiance`` is specified; greater than the radius."""
    motion: tuple[Motion, ...] = ()
    """Motion of the lamp."""

    @field_validator("reference_distance_mm")
    @classmethod
    def _outside(cls, value: float, info: ValidationInfo) -> float:
        radius = info.data.get("radius_mm")
        if radius is not None and value <= radius:
            msg = f"must be greater than radius_mm, {radius:g}"
            raise ValueError(msg)
        return value

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t, see `LightModel`."""
        at, _ = moved_axis(self.motion, self.position_mm, self.position_mm, t)
        radiance = as_number(self.irradiance) / (np.pi * (self.radius_mm / self.reference_distance_mm) ** 2)
        area = LampArea("sphere", np.zeros(3), np.zeros(3), (0.0, self.radius_mm), radiance)
        return Lamp(
            at, np.zeros(3), as_number(self.irradiance), self.reference_distance_mm, EVERYWHERE, EVERYWHERE, area
        )


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
    the texture as albedo, integrated over lamps with a size; the factor 1/π is omitted, so irradiance 1 gives the value
    of the texture. All radiances are then multiplied by the time-dependent brightness. Without ambient light and
    lights, the scene is unlit: radiance is texture times brightness.
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

    @property
    def has_areas(self) -> bool:
        """Whether any lamp has a size."""
        return any(light.lamp(0.0).area is not None for light in self.lights)

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

"""Deformations in the object frame: base model, built-in types, and their union."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, ValidationInfo, field_validator, model_validator
from pydantic import Field as Described

from scenetruth.discovery import discriminated_union
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.motion_presets import GrowthPreset, fill_in_preset, preset_or_fields
from scenetruth.scene.motion.point_maps import rotate_points
from scenetruth.scene.motion.time_curve import TimeCurve, evaluate_curve
from scenetruth.scene.taylor import JetField, exp_quotient, sinc_root, strip_derivatives, where
from scenetruth.validated_model import Direction, Finite, FrozenModel, NonNegative, Positive, Vector3

__all__ = [
    "Bending",
    "Deformation",
    "DeformationModel",
    "DeformationStep",
    "Growth",
    "Hinge",
    "OwnFrameModel",
    "StarDisplacement",
    "StarStrain",
    "Surroundings",
    "Unrolling",
    "roll_problem",
]


@dataclass(frozen=True)
class Surroundings:
    """Context of a deformation: smallest and largest X of the (flat) mesh in mm, and frame interval in s."""

    extent_mm: tuple[float, float]
    frame_interval_s: float

    @property
    def hours_per_frame(self) -> float:
        """Frame interval in hours."""
        return self.frame_interval_s / 3600


class OwnFrameModel(FrozenModel):
    """Entry of an object's deformation list, applied in the object frame before the pose."""

    kind: str
    """Type of the deformation."""


class DeformationModel(OwnFrameModel):
    """Base class of deformations, defined by a formula for positions; derivatives are computed automatically."""

    in_the_flat: ClassVar[bool] = False
    """Whether it acts on the flat sheet (leaf blade) before the sheet is shaped."""

    @abstractmethod
    def point_map(self, around: Surroundings) -> PointMap:
        """Return the point map in the object frame."""

    def problem(self, around: Surroundings, points: Points, t: JetField) -> tuple[str, str]:
        """Return the field that makes the deformation invalid at time t, and a message, or empty strings."""
        return "", ""


@dataclass(frozen=True, eq=False)
class DeformationStep:
    """Point map of one deformation of an object, with its index in the deformation list."""

    number: int
    entry: DeformationModel
    surroundings: Surroundings
    point_map: PointMap

    def __call__(self, points: Points, t: JetField) -> Points:
        """Apply the map, see `PointMap`."""
        return self.point_map(points, t)

    def problem(self, points: Points, t: JetField) -> tuple[str, str]:
        """Return why the map is invalid for points (arrays) at a time, see `DeformationModel.problem`."""
        return self.entry.problem(self.surroundings, points, t)


class Bending(DeformationModel):
    """Bending over a cylinder towards -Z, the upper side; isometric for flat sheets.

    The curvature is constant over ``length_mm`` and zero beyond. Points off Z = 0 keep their distance from the bent
    plane Z = 0 (parallel curves).
    """

    kind: Literal["bending"]
    """``bending``."""
    angle_deg: TimeCurve
    """Total bending angle in degrees, positive towards the upper side."""
    from_mm: Finite = 0.0
    """X at the start of the bend."""
    length_mm: Positive
    """Arc length of the bend."""
    across: bool = False
    """Bend Y instead of X, symmetrically about Y = 0, starting at a distance of ``from_mm``."""

    @field_validator("across")
    @classmethod
    def _to_either_side(cls, value: bool, info: ValidationInfo) -> bool:
        if value and info.data.get("from_mm", 0.0) < 0:
            msg = "a bend across Y starts at a distance from Y = 0: from_mm must not be negative"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of the bend.

        With the distance u from the start and the angle θ = κ u, a point maps to the arc point (sin θ, -(1 - cos θ)) /
        κ, offset by its Z along the arc normal (sin θ, cos θ).
        """

        def bend(points: Points, t: JetField) -> Points:
            x, y, z = points
            before, u, beyond = _parts(y if self.across else x, self)
            angle = _curvature(self, t) * u
            sine, cosine = np.sin(angle), np.cos(angle)
            half = sinc_root(angle * angle * 0.25)
            flat = before + u * sinc_root(angle * angle) + beyond * cosine + z * sine
            z = z * cosine - 0.5 * u * angle * half * half - beyond * sine
            return (x, flat, z) if self.across else (flat, y, z)

        return bend

    def problem(self, around: Surroundings, points: Points, t: JetField) -> tuple[str, str]:
        """Return the field that makes the bend invalid, and a message; or empty strings."""
        _, u, _ = _parts(points[1] if self.across else points[0], self)
        curvature = float(np.ravel(_curvature(self, t))[0])
        turned = float(np.rad2deg(np.max(np.abs(curvature * u))))
        if turned >= 360:
            return "angle_deg", f"bends the sheet by {turned:.6g} degrees, which self-intersects; use less than 360"
        tightest = float(np.min(1 + curvature * np.where(u == 0, 0, points[2])))
        if tightest <= 0:
            return "angle_deg", (
                f"the radius of the bend, {abs(1 / curvature):.6g} mm, is smaller than the extent along Z; "
                "increase length_mm or reduce the angle"
            )
        return "", ""


def _curvature(entry: Bending, t: JetField) -> Any:
    """Return the curvature in 1/mm."""
    return np.pi / 180 / entry.length_mm * evaluate_curve(entry.angle_deg, t)


def _parts(x: Any, entry: Bending) -> tuple[Any, Any, Any]:
    """Split a coordinate into the parts before, inside and beyond the bend; across, on either side of zero."""
    # Zero is assigned to one side, so a bend that starts at zero is one smooth piece there.
    side = np.where(strip_derivatives(x) < 0, -1, 1) if entry.across else 1
    distance = x * side - entry.from_mm
    at, length = strip_derivatives(distance), entry.length_mm
    bent = where(at < 0, 0.0, where(at > length, length, distance)) * side
    beyond = where(at > length, distance - length, 0.0) * side
    return x - bent - beyond, bent, beyond


_LARGEST_EXPONENT = 20.0


class Growth(DeformationModel):
    """Areal growth by a relative elemental growth rate r(X, t).

    r = rate_per_hour g(X) (1 + diel_amplitude cos(2 π (hour - peak_h) / 24)) with linear g, ``base_to_tip`` at base and
    tip. X is the material coordinate. Growth acts on the flat sheet, or along X and Y of other meshes. The origin of
    the object frame is fixed, and growth is zero at t = 0.
    """

    model_config = ConfigDict(json_schema_extra=preset_or_fields())
    in_the_flat: ClassVar[bool] = True

    kind: Literal["growth"]
    """``growth``."""
    preset: GrowthPreset | None = None
    """Preset that supplies the default values; null for none."""
    rate_per_hour: Finite
    """Daily mean of the relative areal growth rate in 1/h where g = 1; 0.01 is 1 %/h, negative rates shrink."""
    base_to_tip: tuple[Finite, Finite] = (1.0, 1.0)
    """g at base and tip."""
    base_mm: Finite | None = None
    """X of the base; default: smallest X of the mesh."""
    tip_mm: Finite | None = None
    """X of the tip; default: largest X of the mesh."""
    along_share: Annotated[float, Described(ge=-1, le=2, allow_inf_nan=False)] | None = None
    """Fraction p of the rate along X, with 1 - p along Y; null for isotropic growth. Values outside 0 to 1 describe
    lateral contraction: a sheet of Poisson's ratio ν stretched along X has p = 1 / (1 - ν), which is 2 for rubber;
    stretched along Y, -ν / (1 - ν).
    """
    diel_amplitude: NonNegative = 0.0
    """Amplitude of the daily variation, relative to the mean."""
    peak_h: Finite = 6.0
    """Hour of the day with the highest rate."""
    start_h: Finite = 0.0
    """Hour of the day at t = 0."""
    solid: bool = False
    """Isotropic growth including Z: every surface of the body grows by r, its volume by 1.5 r."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return fill_in_preset(given)

    @field_validator("tip_mm")
    @classmethod
    def _beyond_the_base(cls, value: float | None, info: ValidationInfo) -> float | None:
        base = info.data.get("base_mm")
        if value is not None and base is not None and value <= base:
            msg = f"must be larger than base_mm, {base:g}"
            raise ValueError(msg)
        return value

    @field_validator("solid")
    @classmethod
    def _alike_everywhere(cls, value: bool, info: ValidationInfo) -> bool:
        base, tip = info.data.get("base_to_tip", (1.0, 1.0))
        if value and (base != tip or info.data.get("along_share") is not None):
            msg = "growth of a solid is uniform and isotropic: omit along_share and base_to_tip"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of growth.

        With the time integral R(t) of the rate and linear g(X), isotropic growth is the conformal map f(z) = ∫ exp(g R
        / 2) dz of z = X + i Y: the local area factor is |f'|² = exp(g R), and log |f'| is harmonic because g is linear.
        Anisotropic growth with fraction p along X is X' = ∫ exp(p g R) dX, Y' = Y exp((1 - p) g R), with the same
        Jacobian exp(g R).
        """
        at_origin, slope = _gradient(self, around.extent_mm)

        def grow(points: Points, t: JetField) -> Points:
            x, y, z = points
            grown = _grown(self, around.hours_per_frame, t)
            if self.along_share is None:
                scale = np.exp(0.5 * at_origin * grown)
                x, y = _conformal(x, y, 0.5 * slope * grown) if slope else (x, y)
                return x * scale, y * scale, z * scale if self.solid else z
            along, across = self.along_share, 1 - self.along_share
            length, width = x * np.exp(along * at_origin * grown), y * np.exp(across * at_origin * grown)
            if slope:
                length = length * exp_quotient(along * slope * grown * x)
                width = width * np.exp(across * slope * grown * x)
            return length, width, z

        return grow

    def problem(self, around: Surroundings, points: Points, t: JetField) -> tuple[str, str]:
        """Return the field that makes growth invalid for points at a time, and a message; or empty strings."""
        if self.base_to_tip[0] != self.base_to_tip[1]:
            base, tip = _ends(self, around.extent_mm)
            if tip <= base:
                return "tip_mm", f"base and tip coincide: base {base:g} mm, tip {tip:g} mm"
        at_origin, slope = _gradient(self, around.extent_mm)
        at_points = at_origin + slope * strip_derivatives(points[0])
        grown = float(np.max(np.abs(_grown(self, around.hours_per_frame, t) * at_points)))
        if self.along_share is not None:
            grown *= max(1.0, abs(self.along_share), abs(1 - self.along_share))
        if not grown <= _LARGEST_EXPONENT:
            message = f"grows or shrinks by a factor of exp({grown:.4g}) within the frames; reduce the rate"
            return "rate_per_hour", message
        return "", ""


def _conformal(x: Any, y: Any, slope: Any) -> tuple[Any, Any]:
    """Return the real and imaginary part of (exp(slope z) - 1) / slope, regular at zero slope."""
    p, q = slope * x, slope * y
    half = sinc_root(q * q * 0.25)
    return x * exp_quotient(p) * np.cos(q) - 0.5 * q * y * half * half, y * np.exp(p) * sinc_root(q * q)


def _grown(entry: Growth, hours_per_frame: float, t: JetField) -> Any:
    """Return the time integral of the rate at g = 1 from 0 to t."""
    hours = hours_per_frame * t
    turns = 2 * np.pi / 24
    if entry.diel_amplitude == 0:
        return entry.rate_per_hour * hours
    phase = turns * (entry.start_h - entry.peak_h)
    # sin(phase + 2 d) - sin(phase) as a product, to avoid cancellation for small d.
    half = turns / 2 * hours
    daily = entry.diel_amplitude / turns * 2 * np.sin(half) * np.cos(half + phase)
    return entry.rate_per_hour * (hours + daily)


def _gradient(entry: Growth, extent_mm: tuple[float, float]) -> tuple[float, float]:
    """Return g at X = 0 and its slope in 1/mm."""
    at_base, at_tip = entry.base_to_tip
    if at_base == at_tip:
        return at_base, 0.0
    base, tip = _ends(entry, extent_mm)
    slope = (at_tip - at_base) / (tip - base)
    return at_base - slope * base, slope


def _ends(entry: Growth, extent_mm: tuple[float, float]) -> tuple[float, float]:
    base = extent_mm[0] if entry.base_mm is None else entry.base_mm
    return base, extent_mm[1] if entry.tip_mm is None else entry.tip_mm


class Hinge(DeformationModel):
    """Rotation about an axis in the object frame by a time-dependent angle, such as a leaf about its petiole."""

    kind: Literal["hinge"]
    """``hinge``."""
    axis: Direction = (0.0, 1.0, 0.0)
    """Direction of the axis in the object frame."""
    point_mm: Vector3 = (0.0, 0.0, 0.0)
    """Point on the axis in the object frame."""
    angle_deg: TimeCurve
    """Angle in degrees (right-hand rule)."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the point map, see `DeformationModel`."""
        return lambda points, t: rotate_points(
            points, self.axis, np.pi / 180 * evaluate_curve(self.angle_deg, t), self.point_mm
        )


class StarDisplacement(DeformationModel):
    """Star pattern (DIC Challenge 2.0, Reu et al. 2022): V = amplitude_mm cos(2 π Y / p(X)), p linear in X."""

    in_the_flat: ClassVar[bool] = True

    kind: Literal["star"]
    """``star``."""
    amplitude_mm: TimeCurve
    """Amplitude of the displacement in mm."""
    period_mm: tuple[Positive, Positive]
    """Period p at the smallest and largest X of the mesh in mm."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the point map, see `DeformationModel`."""
        period = _star_period(self.period_mm, around.extent_mm)

        def displace(points: Points, t: JetField) -> Points:
            x, y, z = points
            return x, y + evaluate_curve(self.amplitude_mm, t) * np.cos(2 * np.pi * y / period(x)), z

        return displace


class StarStrain(DeformationModel):
    """Star pattern of strain (DIC Challenge 2.0, Reu et al. 2022): V = strain p / (2 π) sin(2 π Y / p), p linear in X.

    The gradient ∂V/∂Y = strain cos(2 π Y / p) has the same amplitude at every period.
    """

    in_the_flat: ClassVar[bool] = True

    kind: Literal["star_strain"]
    """``star_strain``."""
    strain: TimeCurve
    """Amplitude of ∂V/∂Y."""
    period_mm: tuple[Positive, Positive]
    """Period p at the smallest and largest X of the mesh in mm."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the point map, see `DeformationModel`."""
        period = _star_period(self.period_mm, around.extent_mm)

        def displace(points: Points, t: JetField) -> Points:
            x, y, z = points
            waves = 2 * np.pi / period(x)
            return x, y + evaluate_curve(self.strain, t) / waves * np.sin(waves * y), z

        return displace


def _star_period(period_mm: tuple[float, float], extent_mm: tuple[float, float]) -> Callable[[Any], Any]:
    """Return the period of a star as a function of X: linear between the smallest and largest X."""
    left, right = extent_mm
    at_left, at_right = period_mm
    slope = (at_right - at_left) / (right - left) if right > left else 0.0
    return lambda x: at_left + slope * (x - left)


class Unrolling(DeformationModel):
    """Sheet rolled up beyond a front that moves along X; isometric for flat sheets.

    The roll is a logarithmic spiral with radius of curvature radius_mm - tightening (arc length from the front). It
    lies on one side of the sheet without self-intersection. Points off Z = 0 keep their distance from the rolled plane
    Z = 0.
    """

    kind: Literal["unrolling"]
    """``unrolling``."""
    length_mm: Positive
    """Largest X of the material at all times."""
    front_mm: TimeCurve
    """X of the front, beyond which the sheet is rolled up."""
    radius_mm: Positive
    """Radius of curvature of the roll at the front."""
    tightening: Annotated[float, Described(ge=0, lt=1, allow_inf_nan=False, validate_default=True)] = 0.02
    """Decrease of the radius per arc length; 0 is a circle, which must not close."""
    side: Literal["upper", "lower"] = "upper"
    """Side of the roll: ``upper`` is -Z."""

    @field_validator("tightening")
    @classmethod
    def _free(cls, value: float, info: ValidationInfo) -> float:
        length, front, radius = (info.data.get(name) for name in ("length_mm", "front_mm", "radius_mm"))
        if length is None or front is None or radius is None:
            return value
        at_zero = float(np.ravel(evaluate_curve(front, np.zeros(1)))[0])
        problem = roll_problem(length - at_zero, radius, value)
        if problem:
            msg = f"{problem} at t = 0"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of the opening roll.

        At the distance u from the front the radius is ρ = ρ0 - c u and the angle θ = ∫ du / ρ = -log(1 - c u / ρ0) / c,
        so the curve ∫ exp(i θ) du is ρ0 ((ρ / ρ0) exp(i θ) - 1) / (i - c).
        """
        radius, c = self.radius_mm, self.tightening
        sign = -1.0 if self.side == "upper" else 1.0

        def roll(points: Points, t: JetField) -> Points:
            x, y, z = points
            u = _rolled(x, self, t)
            angle = _angle(u, self)
            sine, cosine = np.sin(angle), np.cos(angle)
            shrunk = 1 - (c / radius) * u
            real, imaginary = shrunk * cosine - 1, shrunk * sine
            along = radius / (1 + c * c) * (imaginary - c * real)
            up = radius / (1 + c * c) * (-1 * real - c * imaginary)
            return x - u + along - sign * (z * sine), y, sign * up + z * cosine

        return roll

    def problem(self, around: Surroundings, points: Points, t: JetField) -> tuple[str, str]:
        """Return the field that makes the roll invalid for points at a time, and a message; or empty strings."""
        front = float(np.ravel(evaluate_curve(self.front_mm, t))[0])
        problem = roll_problem(self.length_mm - front, self.radius_mm, self.tightening)
        if problem:
            return "front_mm", problem
        end = float(np.max(points[0]))
        if end > self.length_mm * (1 + 1e-9):
            return "length_mm", f"is less than the end of the mesh, {end:.6g} mm"
        u = _rolled(points[0], self, t)
        rolled = float(np.max(u))
        if rolled == 0:
            return "", ""
        low, high = float(np.min(points[2][u > 0])), float(np.max(points[2][u > 0]))
        c, inner = self.tightening, self.radius_mm - self.tightening * rolled
        towards_inside = -low if self.side == "upper" else high
        # The smallest gap between turns is the distance to the next outer turn, at the tightest point.
        room = inner * np.expm1(2 * np.pi * c) / (1 + c * c)
        closed = float(_angle(np.array([rolled]), self)[0]) >= 2 * np.pi
        if towards_inside >= inner or (closed and high - low >= room):
            space = min(inner, room) if closed else inner
            return "radius_mm", (
                f"self-intersecting unrolling: the sheet extends over {high - low:.6g} mm across its plane Z = 0, but "
                f"the gap of the roll is {space:.6g} mm"
            )
        return "", ""


def roll_problem(rolled_mm: float, radius_mm: float, tightening: float) -> str:
    """Return a message if a length of a sheet cannot be rolled up, else an empty string."""
    if tightening == 0 and rolled_mm >= 2 * pi * radius_mm:
        turn = 2 * pi * radius_mm
        return f"self-intersecting unrolling: {rolled_mm:.6g} mm exceed {turn:.6g} mm, one turn; increase tightening"
    if tightening * rolled_mm >= radius_mm:
        most = radius_mm / tightening
        return (
            f"self-intersecting unrolling: the radius falls to zero within {most:.6g} mm, but {rolled_mm:.6g} mm are "
            "rolled up; increase radius_mm or reduce tightening"
        )
    return ""


def _rolled(x: Any, entry: Unrolling, t: JetField) -> Any:
    """Return the distance from the front, zero before it."""
    u = x - evaluate_curve(entry.front_mm, t)
    return where(strip_derivatives(u) > 0, u, 0.0)


def _angle(u: Any, entry: Unrolling) -> Any:
    c = entry.tightening
    return u / entry.radius_mm if c == 0 else np.log1p(-c / entry.radius_mm * u) / -c


if TYPE_CHECKING:
    Deformation = DeformationModel
else:
    Deformation = discriminated_union(DeformationModel, "scenetruth.scene.deformation")

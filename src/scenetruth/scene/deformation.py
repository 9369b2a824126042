"""Deformations in the frame of an object: the model that all share, every type of them, and the union of all types."""

from __future__ import annotations

from abc import abstractmethod
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
    "Surroundings",
    "Unrolling",
    "roll_problem",
]


@dataclass(frozen=True)
class Surroundings:
    """What deformations must know of their object and of the scene.

    ``extent_mm``: Least and largest X of the mesh, of a sheet in the flat, mm.
    ``frame_interval_s``: Time between frames in seconds.
    """

    extent_mm: tuple[float, float]
    frame_interval_s: float

    @property
    def hours_per_frame(self) -> float:
        """Time between frames in hours."""
        return self.frame_interval_s / 3600


class OwnFrameModel(FrozenModel):
    """What may stand in an object's list of deformations: it acts in the own frame, before the object is posed."""

    kind: str
    """Name of the deformation."""


class DeformationModel(OwnFrameModel):
    """What all deformations share. One is written as one formula for positions; derivatives follow from it."""

    in_the_flat: ClassVar[bool] = False
    """Whether it acts on the flat of a sheet (a leaf's blade), before the sheet takes its shape."""

    @abstractmethod
    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of the deformation in the object's own frame."""

    def problem(self, around: Surroundings, points: Points, t: JetField) -> tuple[str, str]:
        """Return which field keeps the deformation from being applied to points at a time, and why.

        ``points``: Coordinates before the deformation, mm: arrays.
        ``t``: Time in frames, shape (1,).
        """
        return "", ""


@dataclass(frozen=True, eq=False)
class DeformationStep:
    """A map that knows which deformation of its object it is.

    ``number``: Its place in the object's list of deformations.
    ``entry``: The deformation of the scene.
    ``surroundings``: What it has to know.
    ``point_map``: The map.
    """

    number: int
    entry: DeformationModel
    surroundings: Surroundings
    point_map: PointMap

    def __call__(self, points: Points, t: JetField) -> Points:
        """Move points; see `PointMap`."""
        return self.point_map(points, t)

    def problem(self, points: Points, t: JetField) -> tuple[str, str]:
        """Return what keeps it from being applied to points (arrays) at a time; see `DeformationModel.problem`."""
        return self.entry.problem(self.surroundings, points, t)


class Bending(DeformationModel):
    """Bending over a cylinder, isometric for flat sheets: from a place on X turns towards -Z, the upper side.

    Over ``length_mm`` the curvature is the same everywhere, beyond it the sheet goes on straight. Points off Z = 0 keep
    their distance from the bent plane Z = 0 (parallel curves).
    """

    kind: Literal["bending"]
    """``bending``."""
    angle_deg: TimeCurve
    """Angle of the whole bend in degrees, positive towards the upper side."""
    from_mm: Finite = 0.0
    """X where the bend begins."""
    length_mm: Positive
    """Length of the bend, measured on the sheet."""
    across: bool = False
    """Whether Y is bent instead of X, to either side of Y = 0, from a distance of ``from_mm`` on."""

    @field_validator("across")
    @classmethod
    def _to_either_side(cls, value: bool, info: ValidationInfo) -> bool:
        if value and info.data.get("from_mm", 0.0) < 0:
            msg = "a bend across begins at a distance from Y = 0: from_mm must not be negative"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of a bend.

        With u the distance from where it begins, and θ = κ u the angle there, a point goes to the place of u on an arc,
        (sin θ, -(1 - cos θ)) / κ, and from there by its Z along the arc's normal (sin θ, cos θ).
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
        """Return the field that makes a bend unfit for points at a time, and why; or two empty strings."""
        _, u, _ = _parts(points[1] if self.across else points[0], self)
        curvature = float(np.ravel(_curvature(self, t))[0])
        turned = float(np.rad2deg(np.max(np.abs(curvature * u))))
        if turned >= 360:
            return "angle_deg", f"bends the sheet by {turned:.6g} degrees, into itself; make it less than 360"
        tightest = float(np.min(1 + curvature * np.where(u == 0, 0, points[2])))
        if tightest <= 0:
            return "angle_deg", (
                f"the radius of the bend, {abs(1 / curvature):.6g} mm, is less than what stands off the plane Z = 0; "
                "make length_mm larger or the angle smaller"
            )
        return "", ""


def _curvature(entry: Bending, t: JetField) -> Any:
    """Return the curvature in 1/mm."""
    return np.pi / 180 / entry.length_mm * evaluate_curve(entry.angle_deg, t)


def _parts(x: Any, entry: Bending) -> tuple[Any, Any, Any]:
    """Split a coordinate into what lies before the bend, in it and beyond it; across, to either side of zero."""
    # Zero belongs to one side, so that a bend from zero on is one smooth piece there.
    side = np.where(strip_derivatives(x) < 0, -1, 1) if entry.across else 1
    distance = x * side - entry.from_mm
    at, length = strip_derivatives(distance), entry.length_mm
    bent = where(at < 0, 0.0, where(at > length, length, distance)) * side
    beyond = where(at > length, distance - length, 0.0) * side
    return x - bent - beyond, bent, beyond


_LARGEST_EXPONENT = 20.0


class Growth(DeformationModel):
    """Growth of the area by a relative elemental growth rate r(X, t), which may fall from base to tip and change daily.

    r = rate_per_hour g(X) (1 + diel_amplitude cos(2 π (hour - peak_h) / 24)); g is linear, ``base_to_tip`` at the base
    and at the tip. X is the material point's, not its present place. On sheets it acts in the flat, elsewhere along X
    and Y. The own frame's origin stays in place, and at t = 0 nothing has grown.
    """

    model_config = ConfigDict(json_schema_extra=preset_or_fields())
    in_the_flat: ClassVar[bool] = True

    kind: Literal["growth"]
    """``growth``."""
    preset: GrowthPreset | None = None
    """Growth by name, whose values stand for all fields that are not given; null for none."""
    rate_per_hour: Finite
    """Relative rate of the area in 1/h where g = 1, in the mean of a day; 0.01 is 1 %/h, negative rates shrink."""
    base_to_tip: tuple[Finite, Finite] = (1.0, 1.0)
    """g at the base and at the tip."""
    base_mm: Finite | None = None
    """X of the base; the least X of the mesh if not given."""
    tip_mm: Finite | None = None
    """X of the tip; the largest X of the mesh if not given."""
    along_share: Annotated[float, Described(ge=-1, le=2, allow_inf_nan=False)] | None = None
    """Share p of the rate that goes along X, the rest, 1 - p, goes along Y; null for growth alike in all directions.
    More than 1 for what gets narrower as it gets longer: a sheet of Poisson's ratio ν that is pulled along X has
    p = 1 / (1 - ν), which is 2 for rubber; pulled along Y, it has -ν / (1 - ν)."""
    diel_amplitude: NonNegative = 0.0
    """Largest deviation from the mean of a day, relative to it."""
    peak_h: Finite = 6.0
    """Hour of the day with the highest rate."""
    start_h: Finite = 0.0
    """Hour of the day at t = 0."""
    solid: bool = False
    """Whether Z grows as X and Y do: every surface of the body then grows by r, its volume by 1.5 r."""

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
            msg = "a solid grows alike everywhere and in all directions: leave along_share and base_to_tip away"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of growth.

        With R(t) the rate integrated over time, and g(X) linear, growth alike in all directions is the conformal map
        f(z) = ∫ exp(g R / 2) dz of z = X + i Y: its local area grows by |f'|² = exp(g R), and log |f'| is harmonic
        because g is linear. Other growth, of the share p along X, is X' = ∫ exp(p g R) dX, Y' = Y exp((1 - p) g R),
        with the Jacobian exp(g R) again.
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
        """Return the field that makes growth unfit for points at a time, and why; or two empty strings."""
        if self.base_to_tip[0] != self.base_to_tip[1]:
            base, tip = _ends(self, around.extent_mm)
            if tip <= base:
                return "tip_mm", f"growth has no length to change over: base {base:g} mm, tip {tip:g} mm"
        at_origin, slope = _gradient(self, around.extent_mm)
        at_points = at_origin + slope * strip_derivatives(points[0])
        grown = float(np.max(np.abs(_grown(self, around.hours_per_frame, t) * at_points)))
        if self.along_share is not None:
            grown *= max(1.0, abs(self.along_share), abs(1 - self.along_share))
        if not grown <= _LARGEST_EXPONENT:
            message = f"grows or shrinks by a factor of exp({grown:.4g}) within the frames; make it slower"
            return "rate_per_hour", message
        return "", ""


def _conformal(x: Any, y: Any, slope: Any) -> tuple[Any, Any]:
    """Return real and imaginary part of (exp(slope z) - 1) / slope, written so that a slope of zero is no exception."""
    p, q = slope * x, slope * y
    half = sinc_root(q * q * 0.25)
    return x * exp_quotient(p) * np.cos(q) - 0.5 * q * y * half * half, y * np.exp(p) * sinc_root(q * q)


def _grown(entry: Growth, hours_per_frame: float, t: JetField) -> Any:
    """Return the rate where g = 1, integrated from 0 to t."""
    hours = hours_per_frame * t
    turns = 2 * np.pi / 24
    if entry.diel_amplitude == 0:
        return entry.rate_per_hour * hours
    phase = turns * (entry.start_h - entry.peak_h)
    # sin(phase + 2 d) - sin(phase) as a product, to keep small d exact.
    half = turns / 2 * hours
    daily = entry.diel_amplitude / turns * 2 * np.sin(half) * np.cos(half + phase)
    return entry.rate_per_hour * (hours + daily)


def _gradient(entry: Growth, extent_mm: tuple[float, float]) -> tuple[float, float]:
    """Return g at X = 0, and its slope in 1/mm."""
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
    """Rotation about an axis in the object's own frame by an angle that changes: a leaf about its petiole."""

    kind: Literal["hinge"]
    """``hinge``."""
    axis: Direction = (0.0, 1.0, 0.0)
    """Direction of the axis in the own frame."""
    point_mm: Vector3 = (0.0, 0.0, 0.0)
    """Point on the axis in the own frame."""
    angle_deg: TimeCurve
    """Angle in degrees (right-hand rule)."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map; see `DeformationModel`."""
        return lambda points, t: rotate_points(
            points, self.axis, np.pi / 180 * evaluate_curve(self.angle_deg, t), self.point_mm
        )


class StarDisplacement(DeformationModel):
    """The star of the DIC community: displacement across the sheet, a cosine in Y whose period changes along X.

    V = amplitude_mm cos(2 π Y / p(X)), p linear from the left to the right edge (Reu et al. 2022, DIC Challenge 2.0).
    """

    in_the_flat: ClassVar[bool] = True

    kind: Literal["star"]
    """``star``."""
    amplitude_mm: TimeCurve
    """Largest displacement in mm."""
    period_mm: tuple[Positive, Positive]
    """Period p at the least and at the largest X of the mesh in mm."""

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map; see `DeformationModel`."""
        left, right = around.extent_mm
        at_left, at_right = self.period_mm
        slope = (at_right - at_left) / (right - left) if right > left else 0.0

        def displace(points: Points, t: JetField) -> Points:
            x, y, z = points
            return (
                x,
                y + evaluate_curve(self.amplitude_mm, t) * np.cos(2 * np.pi * y / (at_left + slope * (x - left))),
                z,
            )

        return displace


class Unrolling(DeformationModel):
    """A sheet rolled up beyond a front that moves along X, isometric for flat sheets.

    The roll is a logarithmic spiral, the curve whose radius of curvature falls steadily along it: radius_mm -
    tightening (distance from the front, measured on the sheet). It lies on one side of the sheet and never meets
    itself. Points off Z = 0 keep their distance from the rolled plane Z = 0.
    """

    kind: Literal["unrolling"]
    """``unrolling``."""
    length_mm: Positive
    """X up to which there is material, at all times."""
    front_mm: TimeCurve
    """X of the front: the sheet is as it was up to here, and rolled up beyond."""
    radius_mm: Positive
    """Radius of curvature of the roll at the front."""
    tightening: Annotated[float, Described(ge=0, lt=1, allow_inf_nan=False, validate_default=True)] = 0.02
    """Loss of radius per length of the sheet; 0 is a circle, which may not close."""
    side: Literal["upper", "lower"] = "upper"
    """Side that the roll lies on: ``upper`` is -Z."""

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
        """Return the map of a roll that opens.

        At the distance u from the front the radius is ρ = ρ0 - c u and the angle θ = ∫ du / ρ = -log(1 - c u / ρ0) / c,
        so that the curve ∫ exp(i θ) du is ρ0 ((ρ / ρ0) exp(i θ) - 1) / (i - c).
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
        """Return the field that makes a roll unfit for points at a time, and why; or two empty strings."""
        front = float(np.ravel(evaluate_curve(self.front_mm, t))[0])
        problem = roll_problem(self.length_mm - front, self.radius_mm, self.tightening)
        if problem:
            return "front_mm", problem
        end = float(np.max(points[0]))
        if end > self.length_mm * (1 + 1e-9):
            return "length_mm", f"is less than where the mesh ends, {end:.6g} mm"
        u = _rolled(points[0], self, t)
        rolled = float(np.max(u))
        if rolled == 0:
            return "", ""
        low, high = float(np.min(points[2][u > 0])), float(np.max(points[2][u > 0]))
        c, inner = self.tightening, self.radius_mm - self.tightening * rolled
        towards_inside = -low if self.side == "upper" else high
        # Between turns there is at least the distance to the next turn outside, where the roll is tightest.
        room = inner * np.expm1(2 * np.pi * c) / (1 + c * c)
        closed = float(_angle(np.array([rolled]), self)[0]) >= 2 * np.pi
        if towards_inside >= inner or (closed and high - low >= room):
            space = min(inner, room) if closed else inner
            return "radius_mm", (
                f"self-intersecting unrolling: the sheet reaches over {high - low:.6g} mm across its plane Z = 0, but "
                f"the roll has room for {space:.6g} mm"
            )
        return "", ""


def roll_problem(rolled_mm: float, radius_mm: float, tightening: float) -> str:
    """Say why a length of a sheet cannot be rolled up, or return nothing."""
    if tightening == 0 and rolled_mm >= 2 * pi * radius_mm:
        turn = 2 * pi * radius_mm
        return f"self-intersecting unrolling: {rolled_mm:.6g} mm close a circle of {turn:.6g} mm; tighten the roll"
    if tightening * rolled_mm >= radius_mm:
        most = radius_mm / tightening
        return (
            f"self-intersecting unrolling: the radius falls to zero within {most:.6g} mm, but {rolled_mm:.6g} mm are "
            "rolled up; make radius_mm larger or tightening smaller"
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

"""The models of deformations: motions within an object's own frame, before it is posed."""

from __future__ import annotations

from math import pi
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from scenetruth.model import Direction, Finite, FrozenModel, NonNegative, Positive, Vector3
from scenetruth.scene.motion.presets import GrowthPreset, filled_in, preset_or_fields
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Bending", "Deformation", "DeformationModel", "Growth", "Hinge", "Star", "Unrolling", "roll_problem"]


class DeformationModel(FrozenModel):
    """What all deformations share."""

    in_the_flat: ClassVar[bool] = False
    """Whether it acts on the flat of a sheet (a leaf's blade), before the sheet takes its shape."""


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
    along_share: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] | None = None
    """Share of the rate that goes along X, the rest goes along Y; null for growth alike in all directions."""
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
        return filled_in(given)

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
    tightening: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False, validate_default=True)] = 0.02
    """Loss of radius per length of the sheet; 0 is a circle, which may not close."""
    side: Literal["upper", "lower"] = "upper"
    """Side that the roll lies on: ``upper`` is -Z."""

    @field_validator("tightening")
    @classmethod
    def _free(cls, value: float, info: ValidationInfo) -> float:
        length, front, radius = (info.data.get(name) for name in ("length_mm", "front_mm", "radius_mm"))
        if length is None or front is None or radius is None:
            return value
        at_zero = float(np.ravel(value_at(front, np.zeros(1)))[0])
        problem = roll_problem(length - at_zero, radius, value)
        if problem:
            msg = f"{problem} at t = 0"
            raise ValueError(msg)
        return value


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


class Star(DeformationModel):
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


Deformation = Annotated[Hinge | Growth | Bending | Unrolling | Star, Field(discriminator="kind")]

"""Growth as a map: the area of every piece of a sheet grows by exactly the rate that is given for it."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, ValidationInfo, field_validator, model_validator
from pydantic import Field as Described

from scenetruth.model import Finite, NonNegative
from scenetruth.scene.deformation.base import DeformationModel, Surroundings
from scenetruth.scene.jets import Field, values_of
from scenetruth.scene.jets.smooth import exp_quotient, sinc_root
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.presets import GrowthPreset, filled_in, preset_or_fields

__all__ = ["Growth"]

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

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of growth.

        With R(t) the rate integrated over time, and g(X) linear, growth alike in all directions is the conformal map
        f(z) = ∫ exp(g R / 2) dz of z = X + i Y: its local area grows by |f'|² = exp(g R), and log |f'| is harmonic
        because g is linear. Other growth, of the share p along X, is X' = ∫ exp(p g R) dX, Y' = Y exp((1 - p) g R),
        with the Jacobian exp(g R) again.
        """
        at_origin, slope = _gradient(self, around.extent_mm)

        def grow(points: Points, t: Field) -> Points:
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

    def problem(self, around: Surroundings, points: Points, t: Field) -> tuple[str, str]:
        """Return the field that makes growth unfit for points at a time, and why; or two empty strings."""
        if self.base_to_tip[0] != self.base_to_tip[1]:
            base, tip = _ends(self, around.extent_mm)
            if tip <= base:
                return "tip_mm", f"growth has no length to change over: base {base:g} mm, tip {tip:g} mm"
        at_origin, slope = _gradient(self, around.extent_mm)
        at_points = at_origin + slope * values_of(points[0])
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


def _grown(entry: Growth, hours_per_frame: float, t: Field) -> Any:
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

"""Scene-file fields of a leaf: outline and lobes, bending of the blade, and appearance."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.texture import TextureModel
from scenetruth.validated_model import Finite, FrozenModel, Positive

__all__ = ["LeafAppearance", "LeafForm", "LobeSide", "Petiole", "Serration", "Undulation"]


Floats = NDArray[np.float64]

_HINDMOST_DEG = 144.0  # direction of the rearmost lobe before scaling to the width,
_SHORTER = 0.44  # and its relative shortening compared with the middle lobe
_TIP_DEG = {"acuminate": 20.0, "acute": 30.0}  # half the tip angle
_FULL_FORM = 0.3  # cut from which lobes are fully developed; without a cut the tips are joined by straight lines
_ROUND = 0.4  # rounding of the sinus as a fraction of half the lobe width
_STEPS = 1200


@dataclass(frozen=True, eq=False)
class LobeSide:
    """One side of a lobe whose tip has b >= 0.

    ``azimuth_rad``: Direction of the lobe, from a towards b.
    ``length_mm``: Length from the petiole insertion to the tip.
    ``hand``: 1: rear side, -1: front side. The middle lobe has only the first.
    ``points_mm``: Margin in the lobe frame (x along its axis, y >= 0 away from it) from the sinus, or from the
      insertion, to the tip; shape (n, 2).
    """

    azimuth_rad: float
    length_mm: float
    hand: int
    points_mm: Floats

    @property
    def margin_mm(self) -> float:
        """Length of the margin."""
        return float(np.hypot(*np.diff(self.points_mm, axis=0).T).sum())

    def in_leaf(self, points_mm: Floats) -> Floats:
        """Return points (x, y) of the lobe frame as (a, b), shape (n, 2)."""
        x, y = points_mm[:, 0], self.hand * points_mm[:, 1]
        c, s = np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)
        return np.column_stack([c * x - s * y, s * x + c * y])


@functools.lru_cache(maxsize=64)
def make_lobe_sides(lobes: int, cut: float, tip: str, length_mm: float, width_mm: float) -> tuple[LobeSide, ...]:
    """Return the lobe sides of the half with b >= 0, from the rear of the leaf to its tip."""
    turn = np.linspace(0, np.radians(_HINDMOST_DEG), (lobes + 1) // 2)
    reach = length_mm * (1 - _SHORTER * (turn / turn[-1]) ** 1.6)
    tips = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    stretch = width_mm / 2 / tips[:, 1].max()
    # The widest point is a tip, or very close to it: convergence is immediate.
    for _ in range(50):
        sides = _sides(tips * (1, stretch), cut, np.radians(_TIP_DEG[tip]))
        half = max(float(side.in_leaf(side.points_mm)[:, 1].max()) for side in sides)
        if abs(half / (width_mm / 2) - 1) < 1e-12:
            break
        stretch *= width_mm / 2 / half
    return tuple(sides)


def narrowest_lobe_mm(sides: tuple[LobeSide, ...]) -> float:
    """Return the width of the narrowest lobe."""
    off = [float(side.points_mm[:, 1].max()) for side in sides]
    return min([2 * off[-1], *(one + other for one, other in zip(off[:-1:2], off[1::2], strict=True))])


def _sides(tips: Floats, cut: float, sharp: float) -> list[LobeSide]:
    azimuth, length = np.arctan2(tips[:, 1], tips[:, 0]), np.hypot(*tips.T)
    last = len(tips) - 1
    sides = [LobeSide(float(azimuth[last]), float(length[last]), 1, _rear(length[last], np.pi - azimuth[last], sharp))]
    for outer in range(last, 0, -1):
        inner = outer - 1
        half = (azimuth[outer] - azimuth[inner]) / 2
        # Intersection of the line between both tips with the bisector of both lobes.
        crossing = 2 * length[inner] * length[outer] * np.cos(half) / (length[inner] + length[outer])
        for index, hand in ((outer, -1), (inner, 1)):
            points = _side(length[index], (1 - cut) * crossing, half, min(cut / _FULL_FORM, 1.0), sharp)
            sides.append(LobeSide(float(azimuth[index]), float(length[index]), hand, points))
    return sides


def _side(length: float, sinus: float, half: float, form: float, sharp: float) -> Floats:
    """Return a lobe side from the sinus to the tip, with control points that exclude intersections of neighbours."""
    start = sinus * np.array([np.cos(half), np.sin(half)])
    free, off = length - start[0], start[1]
    straight = start + np.linspace(0, 1, 5)[:, None] * ((length, 0.0) - start)
    lobed = np.array(
        [
            start,
            # Continued across the sinus, so that both sides form one smooth curve.
            start + _ROUND * off * np.array([np.sin(half), -np.cos(half)]),
            # The lobe is widest beyond the sinus; at 1 + 0.42 free / start it would touch the line through the sinus.
            (start[0] + 0.42 * free, off * (1 + min(0.45, 0.35 * free / start[0]))),
            (length - 0.34 * free, 0.34 * free * np.tan(sharp)),
            (length, 0.0),
        ]
    )
    return _bezier(straight + form * (lobed - straight))


def _rear(length: float, gap: float, sharp: float) -> Floats:
    """Return the rear side of the rearmost lobe, from the insertion; the gap is its angle to the petiole."""
    control = [
        (0.0, 0.0),
        (0.22 * length, 0.22 * length * np.tan(0.1 * gap)),
        (0.48 * length, 0.48 * length * min(0.7, np.tan(0.88 * gap))),
        (0.78 * length, 0.22 * length * np.tan(sharp)),
        (length, 0.0),
    ]
    return _bezier(np.array(control))


def _bezier(control: Floats) -> Floats:
    """Return points of a fourth-order Bézier curve."""
    t = np.linspace(0, 1, _STEPS)[:, None]
    points: Floats = control[None, :, :].repeat(_STEPS, axis=0)
    while points.shape[1] > 1:
        points = points[:, :-1] + t[:, None] * (points[:, 1:] - points[:, :-1])
    return points[:, 0]


_MOST_TRIANGLES = 5_000_000
_WIDTHS = {"ovate": 0.62, "lanceolate": 0.28, "cordate": 0.85, "elliptic": 0.55, "palmate": 1.5}
_PARTS_OF_WIDTH = 4  # minimum number of triangles across the blade
_PARTS_OF_TOOTH = 4  # minimum number of edges along a tooth
_PARTS_OF_LOBE = 5  # minimum number of triangles across a lobe
_LONGEST_PETIOLE = 10  # maximum petiole length relative to the blade, which limits unused lattice points
_NARROWEST_PALMATE = 0.8  # minimum width of a palmate leaf relative to its length

Fraction = Annotated[float, Field(ge=0, le=1)]
TurnAngle = Annotated[float, Field(gt=-360, lt=360, allow_inf_nan=False)]


class Serration(FrozenModel):
    """Teeth of the margin, pointing towards the tip."""

    count_per_side: Annotated[int, Field(ge=1, le=500)] = 16
    """Teeth on each side of the blade; for palmate leaves on each side of the middle lobe, with the same spacing on the
    others.
    """
    depth_mm: Positive
    """Depth of the notches in mm."""


class Undulation(FrozenModel):
    """Waves of the margin, with a height that increases with the distance from the midrib."""

    amplitude_mm: Finite
    """Wave height at the widest point of the margin in mm; it grows with the squared distance from the midrib."""
    waves_per_side: Positive = 3.0
    """Number of waves from base to tip."""


class Petiole(FrozenModel):
    """Petiole: a strip of the same sheet that extends from the base to -X and widens into the blade."""

    length_mm: Positive
    """Length in mm."""
    diameter_mm: Positive = 2.0
    """Width in mm."""


class LeafForm(MeshModel):
    """Shape of a leaf: X along the midrib from the base (origin) to the tip, Y across, upper side towards -Z.

    The flat sheet with coordinates (a, b) in mm is shaped by undulation, fold, transverse and longitudinal bending, in
    this order.
    """

    # The default resolution may be too coarse for a small leaf.
    model_config = ConfigDict(validate_default=True)

    outline: Literal["ovate", "lanceolate", "cordate", "elliptic", "palmate"] = "ovate"
    """Outline: ovate (widest below the middle), lanceolate (slender), cordate (heart-shaped, lobes behind the base),
    elliptic (widest in the middle), or palmate (lobes radiating from the petiole, castor-oil plant).
    """
    tip: Literal["acuminate", "acute", "round"] | None = None
    """Tip: acuminate (tapering to a point), acute or round; null: round for elliptic, else acuminate. For palmate
    leaves it applies to every lobe and must not be round.
    """
    length_mm: Positive = 80.0
    """Length of the midrib from the base, where the petiole joins, to the tip in mm."""
    width_mm: Positive | None = None
    """Largest width in mm; null: 0.62, 0.28, 0.85, 0.55 or 1.5 of the length for ovate, lanceolate, cordate, elliptic,
    palmate.
    """
    lobe_depth: Annotated[float, Field(ge=0, le=0.35)] | None = None
    """Extent of the lobes of a cordate leaf behind its base, relative to the length; null: 0.16."""
    lobes: Annotated[int, Field(ge=5, le=11)] | None = None
    """Number of lobes of a palmate leaf, odd; null: 7."""
    lobe_cut: Annotated[float, Field(ge=0, le=0.7)] | None = None
    """Depth of the sinuses of a palmate leaf, as a fraction of the distance from the line between two tips to the
    petiole; null: 0.5.
    """
    serration: Serration | None = None
    """Teeth; null for an entire margin."""
    petiole: Petiole | None = None
    """Petiole; null for none."""
    bend_along_deg: TurnAngle = 0.0
    """Longitudinal bending: angle in degrees between base and tip of the midrib, a circular arc that includes the
    petiole; positive bends the tip towards the upper side. Isometric.
    """
    bend_across_deg: TurnAngle = 0.0
    """Transverse bending: angle in degrees between the margins at the widest point, on a circular arc; positive bends
    them towards the upper side. Isometric.
    """
    fold_deg: Annotated[float, Field(gt=-180, lt=180, allow_inf_nan=False)] = 0.0
    """Fold along the midrib in degrees: the halves enclose 180° minus this angle; positive lifts the margins towards
    the upper side.
    """
    fold_width_mm: Positive | None = None
    """Width of the rounded fold in mm; null: a tenth of the width."""
    undulation: Undulation | None = None
    """Waves of the margin; null for none."""
    resolution_mm: Positive = 1.0
    """Edge length of the triangles in mm."""

    @property
    def full_width_mm(self) -> float:
        """Largest width in mm."""
        return _WIDTHS[self.outline] * self.length_mm if self.width_mm is None else self.width_mm

    @property
    def lobe_mm(self) -> float:
        """Extent of the lobes behind the base, in mm."""
        if self.outline != "cordate":
            return 0.0
        return (0.16 if self.lobe_depth is None else self.lobe_depth) * self.length_mm

    @property
    def lobe_sides(self) -> tuple[LobeSide, ...]:
        """Lobe sides of a palmate leaf's half with b >= 0, from rear to tip; empty for other outlines."""
        if self.outline != "palmate":
            return ()
        return _lobe_sides(self.tip, self.length_mm, self.full_width_mm, self.lobes, self.lobe_cut)

    def scaled(self, size: float) -> Self:
        """Return the leaf with all lengths, including the resolution, multiplied by ``size``."""
        parts = {
            "length_mm": self.length_mm * size,
            "resolution_mm": self.resolution_mm * size,
            "width_mm": self.full_width_mm * size,
            "fold_width_mm": None if self.fold_width_mm is None else self.fold_width_mm * size,
        }
        for name, lengths in (
            ("serration", ("depth_mm",)),
            ("petiole", ("length_mm", "diameter_mm")),
            ("undulation", ("amplitude_mm",)),
        ):
            part = getattr(self, name)
            if part is not None:
                parts[name] = part.model_copy(update={length: getattr(part, length) * size for length in lengths})
        return self.model_copy(update=parts)

    @field_validator("tip")
    @classmethod
    def _pointed_lobes(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value == "round" and info.data.get("outline") == "palmate":
            msg = "the lobes of a palmate outline must be acuminate or acute"
            raise ValueError(msg)
        return value

    @field_validator("width_mm")
    @classmethod
    def _leaf_like(cls, value: float | None, info: ValidationInfo) -> float | None:
        length = info.data.get("length_mm")
        if value is not None and length is not None and not length / 50 <= value <= 2 * length:
            msg = f"must be between 1/50 and 2 times length_mm = {length:g}"
            raise ValueError(msg)
        if value is not None and length is not None and info.data.get("outline") == "palmate":
            least = _NARROWEST_PALMATE * length
            if value < least:
                msg = f"must be at least {least:g}, {_NARROWEST_PALMATE:g} times the length, for a palmate leaf"
                raise ValueError(msg)
        return value

    @field_validator("lobe_depth")
    @classmethod
    def _has_lobes(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("outline", "cordate") != "cordate":
            msg = f"only a cordate outline has lobes, not {info.data['outline']}"
            raise ValueError(msg)
        return value

    @field_validator("lobes", "lobe_cut")
    @classmethod
    def _is_palmate(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("outline", "palmate") != "palmate":
            msg = f"requires a palmate outline, not {info.data['outline']}"
            raise ValueError(msg)
        if value is not None and info.field_name == "lobes" and value % 2 == 0:
            msg = f"must be odd, one middle lobe and pairs of side lobes: {value - 1:g} or {value + 1:g}"
            raise ValueError(msg)
        return value

    @field_validator("serration")
    @classmethod
    def _shallow(cls, value: Serration | None, info: ValidationInfo) -> Serration | None:
        size = _size(info)
        if value is not None and size is not None:
            of, wide, toothed = "width", size[1], size[0]
            lobes = _lobes(info)
            if lobes is not None:
                of, wide, toothed = "narrowest lobe", *lobes
            most = min(wide / 8, toothed / value.count_per_side)
            if value.depth_mm > most:
                msg = f"depth_mm must not exceed {most:g}: an eighth of the {of}, and the spacing of the teeth"
                raise ValueError(msg)
        return value

    @field_validator("petiole")
    @classmethod
    def _slender(cls, value: Petiole | None, info: ValidationInfo) -> Petiole | None:
        size = _size(info)
        if value is None or size is None:
            return value
        if value.length_mm > _LONGEST_PETIOLE * size[0]:
            msg = f"length_mm must not exceed {_LONGEST_PETIOLE} times length_mm of the blade, {size[0]:g}"
            raise ValueError(msg)
        # The gap between the rearmost lobes of a palmate leaf is narrower.
        part, words = (1 / 20, "a twentieth") if info.data["outline"] == "palmate" else (1 / 5, "a fifth")
        if value.diameter_mm > part * size[1]:
            msg = f"diameter_mm must not exceed {words} of the blade's width, {part * size[1]:g}"
            raise ValueError(msg)
        return value

    @field_validator("bend_along_deg")
    @classmethod
    def _does_not_meet_itself(cls, value: float, info: ValidationInfo) -> float:
        size, stalk = _size(info), info.data.get("petiole")
        if size is not None and stalk is not None and abs(value) * (1 + stalk.length_mm / size[0]) >= 360:
            total = abs(value) * (1 + stalk.length_mm / size[0])
            msg = f"bends blade and petiole together by {total:g}°, which self-intersects; use less than 360°"
            raise ValueError(msg)
        return value

    @field_validator("resolution_mm")
    @classmethod
    def _resolves(cls, value: float, info: ValidationInfo) -> float:
        size = _size(info)
        if size is None:
            return value
        (length, width), teeth, stalk = size, info.data.get("serration"), info.data.get("petiole")
        coarsest, area, toothed, parts = width / _PARTS_OF_WIDTH, 0.8 * width * length, length, "width"
        lobes = _lobes(info)
        if lobes is not None:
            coarsest, toothed, parts = lobes[0] / _PARTS_OF_LOBE, lobes[1], "lobes (narrower for a deeper cut)"
        if teeth is not None:
            coarsest = min(coarsest, toothed / teeth.count_per_side / _PARTS_OF_TOOTH)
        if stalk is not None:
            coarsest = min(coarsest, 1.2 * stalk.diameter_mm, stalk.length_mm / 2)
            area += stalk.length_mm * stalk.diameter_mm
        if value > coarsest:
            msg = f"must not exceed {coarsest:.4g} for {parts}, teeth and petiole to be resolved"
            raise ValueError(msg)
        count = area / (math.sqrt(3) / 4 * value**2)
        if count > _MOST_TRIANGLES:
            least = value * math.sqrt(count / _MOST_TRIANGLES)
            msg = f"gives about {count:.3g} triangles, more than 5e6; use at least {least:.3g} mm"
            raise ValueError(msg)
        return value


def _size(info: ValidationInfo) -> tuple[float, float] | None:
    """Return length and width, or None unless both are valid."""
    if not {"outline", "length_mm", "width_mm"} <= info.data.keys():
        return None
    length, width = info.data["length_mm"], info.data["width_mm"]
    return length, _WIDTHS[info.data["outline"]] * length if width is None else width


def _lobes(info: ValidationInfo) -> tuple[float, float] | None:
    """Return the width of the narrowest lobe and the side length of the middle lobe, or None without lobes."""
    size = _size(info)
    if size is None or info.data["outline"] != "palmate" or not {"tip", "lobes", "lobe_cut"} <= info.data.keys():
        return None
    sides = _lobe_sides(info.data["tip"], *size, info.data["lobes"], info.data["lobe_cut"])
    return narrowest_lobe_mm(sides), sides[-1].margin_mm


def _lobe_sides(
    tip: str | None, length: float, width: float, lobes: int | None, cut: float | None
) -> tuple[LobeSide, ...]:
    return make_lobe_sides(
        7 if lobes is None else lobes, 0.5 if cut is None else cut, tip or "acuminate", length, width
    )


_MOTTLING_PEAK = 4.1  # maximum of the mottling in standard deviations


class LeafAppearance(TextureModel):
    """Two-sided leaf texture: four orders of veins, mottling, and hairs."""

    channel: Literal["green", "near_infrared"] = "green"
    """Spectral channel, which sets the defaults: dark blade with bright veins in green light; bright blade with
    slightly darker veins in the near infrared.
    """
    mean: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Mean radiance of the upper side between the veins; null: 0.26 green, 0.62 near infrared."""
    vein_contrast: Annotated[float, Field(ge=-0.9, le=2)] | None = None
    """Radiance of the midrib relative to its surroundings, minus 1; null: 0.85 green, -0.28 near infrared."""
    mottling_wavelength_mm: tuple[Positive, Positive] = (0.8, 5.0)
    """Shortest and longest wavelength of the mottling in mm."""
    mottling_contrast: Annotated[float, Field(ge=0, le=1 / 3)] | None = None
    """Standard deviation of the mottling, divided by the mean; null: 0.08 green, 0.05 near infrared."""
    speckle_density_per_mm2: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Hairs (trichomes) per mm²: bright dots at random positions."""
    speckle_size_mm: Positive = 0.2
    """Full width at half maximum of a dot in mm."""
    speckle_contrast: Annotated[float, Field(ge=0, le=2)] | None = None
    """Radiance of a dot relative to its surroundings, minus 1; null: 0.35 green, 0.15 near infrared."""
    secondary_veins: Annotated[int, Field(ge=1, le=40)] = 9
    """Number of secondary veins on each side of the midrib."""
    secondary_angle_deg: Annotated[float, Field(ge=20, le=90)] = 55.0
    """Angle between secondary veins and midrib; the veins curve towards the tip near the margin."""
    tertiary_spacing_mm: Positive | None = None
    """Mean spacing of the tertiary veins; null: 0.035 of the leaf length. The finest network has a third of it."""
    texels_per_mm: Positive | None = None
    """Texels of the raster per mm; null: as required by dots and mottling, limited to 4 million texels."""
    underside_lightness: Annotated[float, Field(gt=0, le=3)] | None = None
    """Radiance of the underside relative to the upper side; null: 1.3 green, 1.05 near infrared."""
    underside_relief: Annotated[float, Field(ge=0, le=3)] = 1.25
    """Contrast of the veins on the underside relative to the upper side."""

    @property
    def settings(self) -> dict[str, float]:
        """Channel-dependent field values."""
        green = self.channel == "green"
        defaults = {
            "mean": 0.26 if green else 0.62,
            "vein_contrast": 0.85 if green else -0.28,
            "mottling_contrast": 0.08 if green else 0.05,
            "speckle_contrast": 0.35 if green else 0.15,
            "underside_lightness": 1.3 if green else 1.05,
        }
        given = {name: getattr(self, name) for name in defaults}
        return {name: default if given[name] is None else given[name] for name, default in defaults.items()}

    @field_validator("mottling_wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _displayable(self) -> LeafAppearance:
        values = self.settings
        mottling = _MOTTLING_PEAK * values["mottling_contrast"]
        for lightness, relief in ((1.0, 1.0), (values["underside_lightness"], self.underside_relief)):
            veins, mean = values["vein_contrast"] * relief, values["mean"] * lightness
            least = mean * (1 + min(veins, 0) - mottling)
            most = mean * (1 + max(veins, 0) + mottling + values["speckle_contrast"])
            if least < 0 or most > 1:
                msg = (
                    f"radiances of veins, mottling and speckle may range from {least:.3g} to {most:.3g}; reduce "
                    "mean or contrasts to stay within [0, 1]"
                )
                raise ValueError(msg)
        return self

"""Fields of a leaf in a scene file: outline with its lobes, bending of the blade, and appearance."""

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

_HINDMOST_DEG = 144.0  # direction of the hindmost lobe before the width is given,
_SHORTER = 0.44  # and by how much it is shorter than the middle one, as a part
_TIP_DEG = {"acuminate": 20.0, "acute": 30.0}  # half the angle at the tips
_FULL_FORM = 0.3  # from this cut on lobes have their full form; without a cut the tips are joined by straight lines
_ROUND = 0.4  # how far the sinus is rounded, as a part of half the lobe's width there
_STEPS = 1200


@dataclass(frozen=True, eq=False)
class LobeSide:
    """One side of a lobe whose tip has b >= 0.

    ``azimuth_rad``: Direction of the lobe, from a towards b.
    ``length_mm``: Its length from the insertion of the petiole to its tip.
    ``hand``: 1: the side that looks backwards, -1: the one that looks forwards. The middle lobe has only the first.
    ``points_mm``: Margin in the lobe's own frame (x along its axis, y >= 0 away from it) from the sinus, or from the
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
        """Return points (x, y) of the lobe's frame as (a, b), shape (n, 2)."""
        x, y = points_mm[:, 0], self.hand * points_mm[:, 1]
        c, s = np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)
        return np.column_stack([c * x - s * y, s * x + c * y])


@functools.lru_cache(maxsize=64)
def make_lobe_sides(lobes: int, cut: float, tip: str, length_mm: float, width_mm: float) -> tuple[LobeSide, ...]:
    """Return the sides of the lobes of the half with b >= 0, from the rear of the leaf to its tip."""
    turn = np.linspace(0, np.radians(_HINDMOST_DEG), (lobes + 1) // 2)
    reach = length_mm * (1 - _SHORTER * (turn / turn[-1]) ** 1.6)
    tips = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    stretch = width_mm / 2 / tips[:, 1].max()
    # The widest place is a tip, or very nearly: this converges at once.
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
        # Where the line between both tips crosses the line half-way between both lobes.
        crossing = 2 * length[inner] * length[outer] * np.cos(half) / (length[inner] + length[outer])
        for index, hand in ((outer, -1), (inner, 1)):
            points = _side(length[index], (1 - cut) * crossing, half, min(cut / _FULL_FORM, 1.0), sharp)
            sides.append(LobeSide(float(azimuth[index]), float(length[index]), hand, points))
    return sides


def _side(length: float, sinus: float, half: float, form: float, sharp: float) -> Floats:
    """Return a side from the sinus, at a distance and an angle from the lobe's axis, to the tip.

    All control points lie between the axis and the line through the sinus: neighbours never meet.
    """
    start = sinus * np.array([np.cos(half), np.sin(half)])
    free, off = length - start[0], start[1]
    straight = start + np.linspace(0, 1, 5)[:, None] * ((length, 0.0) - start)
    lobed = np.array(
        [
            start,
            # Across the sinus, so that both sides of it are one smooth curve.
            start + _ROUND * off * np.array([np.sin(half), -np.cos(half)]),
            # The lobe is widest beyond the sinus; at 1 + 0.42 free / start it would be on the line through the sinus.
            (start[0] + 0.42 * free, off * (1 + min(0.45, 0.35 * free / start[0]))),
            (length - 0.34 * free, 0.34 * free * np.tan(sharp)),
            (length, 0.0),
        ]
    )
    return _bezier(straight + form * (lobed - straight))


def _rear(length: float, gap: float, sharp: float) -> Floats:
    """Return the rear side of the hindmost lobe, from the insertion; the gap is its angle with the petiole."""
    control = [
        (0.0, 0.0),
        (0.22 * length, 0.22 * length * np.tan(0.1 * gap)),
        (0.48 * length, 0.48 * length * min(0.7, np.tan(0.88 * gap))),
        (0.78 * length, 0.22 * length * np.tan(sharp)),
        (length, 0.0),
    ]
    return _bezier(np.array(control))


def _bezier(control: Floats) -> Floats:
    """Return points of the curve of fourth order."""
    t = np.linspace(0, 1, _STEPS)[:, None]
    points: Floats = control[None, :, :].repeat(_STEPS, axis=0)
    while points.shape[1] > 1:
        points = points[:, :-1] + t[:, None] * (points[:, 1:] - points[:, :-1])
    return points[:, 0]


_MOST_TRIANGLES = 5_000_000
_WIDTHS = {"ovate": 0.62, "lanceolate": 0.28, "cordate": 0.85, "elliptic": 0.55, "palmate": 1.5}
_PARTS_OF_WIDTH = 4  # triangles across the blade, at least
_PARTS_OF_TOOTH = 4  # edges along a tooth, at least
_PARTS_OF_LOBE = 5  # triangles across a lobe, at least
_LONGEST_PETIOLE = 10  # times the blade: longer ones are stems, and fill a lattice with points that are not used
_NARROWEST_PALMATE = 0.8  # least width of a palmate leaf as a part of its length

Fraction = Annotated[float, Field(ge=0, le=1)]
TurnAngle = Annotated[float, Field(gt=-360, lt=360, allow_inf_nan=False)]


class Serration(FrozenModel):
    """Teeth of the margin, which point forward to the tip."""

    count_per_side: Annotated[int, Field(ge=1, le=500)] = 16
    """Teeth on each side of the blade; of a palmate one, on each side of its middle lobe, and on the others as many as
    fit."""
    depth_mm: Positive
    """How deep the notches are cut into the outline, in mm."""


class Undulation(FrozenModel):
    """Waves of the margin: the blade rises and sinks, the more the farther from the midrib."""

    amplitude_mm: Finite
    """Height of the waves at the widest place of the margin in mm; it grows with the square of the distance from the
    midrib."""
    waves_per_side: Positive = 3.0
    """Waves from base to tip."""


class Petiole(FrozenModel):
    """The stalk: a strip of the same sheet that leaves the base backwards (to -X) and widens into the blade."""

    length_mm: Positive
    """Its length in mm."""
    diameter_mm: Positive = 2.0
    """Its width in mm."""


class LeafForm(MeshModel):
    """The form of a leaf: X along the midrib from the base (the origin) to the tip, Y across, upper side towards -Z.

    In the flat it is a sheet with coordinates (a, b) in mm; undulation, fold, bending across and bending along give
    it its form, in this order.
    """

    # The default resolution may be too coarse for a small leaf.
    model_config = ConfigDict(validate_default=True)

    outline: Literal["ovate", "lanceolate", "cordate", "elliptic", "palmate"] = "ovate"
    """Form of the margin: widest below the middle, slender, heart-shaped with lobes behind the base, widest in the
    middle, or with lobes like the fingers of a hand (castor-oil plant), which all begin where the petiole joins."""
    tip: Literal["acuminate", "acute", "round"] | None = None
    """End of the blade: drawn out to a point, pointed, or round; None: round for elliptic, else acuminate. A
    palmate leaf has such a tip on every lobe, and no round one."""
    length_mm: Positive = 80.0
    """Length of the midrib from base to tip in mm; the base is where the petiole joins."""
    width_mm: Positive | None = None
    """Largest width in mm; None: 0.62, 0.28, 0.85, 0.55 or 1.5 of the length for ovate, lanceolate, cordate, elliptic,
    palmate."""
    lobe_depth: Annotated[float, Field(ge=0, le=0.35)] | None = None
    """How far the lobes of a cordate leaf reach behind its base, as a part of the length; None: 0.16."""
    lobes: Annotated[int, Field(ge=5, le=11)] | None = None
    """Lobes of a palmate leaf, an odd number; None: 7."""
    lobe_cut: Annotated[float, Field(ge=0, le=0.7)] | None = None
    """How far the sinuses of a palmate leaf reach from the line between two tips to the petiole, as a part; None:
    0.5."""
    serration: Serration | None = None
    """Teeth; None: an entire margin."""
    petiole: Petiole | None = None
    """The stalk; None: none."""
    bend_along_deg: TurnAngle = 0.0
    """Angle in degrees between base and tip of the midrib, which is a circular arc; positive curls the tip towards the
    upper side. The petiole continues the arc. Keeps lengths."""
    bend_across_deg: TurnAngle = 0.0
    """Angle in degrees between the margins at the widest place, on a circular arc; positive curls them towards the
    upper side. Keeps lengths."""
    fold_deg: Annotated[float, Field(gt=-180, lt=180, allow_inf_nan=False)] = 0.0
    """Fold along the midrib in degrees: the halves meet at 180° less this angle; positive lifts the margins towards the
    upper side."""
    fold_width_mm: Positive | None = None
    """Width of the rounding of the fold in mm; None: a tenth of the width."""
    undulation: Undulation | None = None
    """Waves of the margin; None: none."""
    resolution_mm: Positive = 1.0
    """Length of the edges of the triangles in mm."""

    @property
    def full_width_mm(self) -> float:
        """Largest width in mm."""
        return _WIDTHS[self.outline] * self.length_mm if self.width_mm is None else self.width_mm

    @property
    def lobe_mm(self) -> float:
        """How far the lobes are drawn behind the base, in mm."""
        if self.outline != "cordate":
            return 0.0
        return (0.16 if self.lobe_depth is None else self.lobe_depth) * self.length_mm

    @property
    def lobe_sides(self) -> tuple[LobeSide, ...]:
        """Sides of the lobes of a palmate leaf's half with b >= 0, from rear to tip; none for other outlines."""
        if self.outline != "palmate":
            return ()
        return _lobe_sides(self.tip, self.length_mm, self.full_width_mm, self.lobes, self.lobe_cut)

    def scaled(self, size: float) -> Self:
        """Return a leaf of the same form whose lengths, and those of its triangles, are ``size`` times as large."""
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
            msg = "the lobes of a palmate outline are acuminate or acute"
            raise ValueError(msg)
        return value

    @field_validator("width_mm")
    @classmethod
    def _leaf_like(cls, value: float | None, info: ValidationInfo) -> float | None:
        length = info.data.get("length_mm")
        if value is not None and length is not None and not length / 50 <= value <= 2 * length:
            msg = f"must lie between 1/50 and 2 of length_mm = {length:g}"
            raise ValueError(msg)
        if value is not None and length is not None and info.data.get("outline") == "palmate":
            least = _NARROWEST_PALMATE * length
            if value < least:
                msg = f"must be at least {least:g}, {_NARROWEST_PALMATE:g} of the length, for palmate lobes to spread"
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
            msg = f"only a palmate outline has it, not {info.data['outline']}"
            raise ValueError(msg)
        if value is not None and info.field_name == "lobes" and value % 2 == 0:
            msg = f"must be odd: one lobe in the middle and as many on each side; {value - 1:g} or {value + 1:g}"
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
                msg = f"depth_mm must not exceed {most:g}: an eighth of the {of}, and the distance of the teeth"
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
        # Between the hindmost lobes of a palmate leaf there is less room.
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
            msg = f"bends blade and petiole together by {total:g}°; only below 360° they do not meet"
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
            coarsest, toothed, parts = lobes[0] / _PARTS_OF_LOBE, lobes[1], "lobes (the deeper cut, the narrower)"
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
            msg = f"would make about {count:.3g} triangles; at most 5e6 are made, from {least:.3g} mm on"
            raise ValueError(msg)
        return value


def _size(info: ValidationInfo) -> tuple[float, float] | None:
    """Return length and width as far as they are valid."""
    if not {"outline", "length_mm", "width_mm"} <= info.data.keys():
        return None
    length, width = info.data["length_mm"], info.data["width_mm"]
    return length, _WIDTHS[info.data["outline"]] * length if width is None else width


def _lobes(info: ValidationInfo) -> tuple[float, float] | None:
    """Return the width of the narrowest lobe and the length of the middle lobe's side; None if there are no lobes."""
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


_MOTTLING_PEAK = 4.1  # standard deviations that mottling may reach


class LeafAppearance(TextureModel):
    """What is seen on a leaf: veins of four orders, mottling between them, and hairs; two-sided."""

    channel: Literal["green", "near_infrared"] = "green"
    """Sets the defaults: in green light the blade is dark and its veins bright; in the near infrared it is bright and
    its veins are a little darker."""
    mean: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Mean radiance of the upper side between the veins; None: 0.26 green, 0.62 near infrared."""
    vein_contrast: Annotated[float, Field(ge=-0.9, le=2)] | None = None
    """Radiance of the midrib relative to its surroundings, less 1; None: 0.85 green, -0.28 near infrared."""
    mottling_wavelength_mm: tuple[Positive, Positive] = (0.8, 5.0)
    """Shortest and longest wavelength of the mottling in mm."""
    mottling_contrast: Annotated[float, Field(ge=0, le=1 / 3)] | None = None
    """Standard deviation of the mottling, divided by the mean; None: 0.08 green, 0.05 near infrared."""
    speckle_density_per_mm2: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Hairs (trichomes) per mm²: bright dots at random places."""
    speckle_size_mm: Positive = 0.2
    """Full width of a dot at half its height in mm."""
    speckle_contrast: Annotated[float, Field(ge=0, le=2)] | None = None
    """Radiance of a dot relative to its surroundings, less 1; None: 0.35 green, 0.15 near infrared."""
    secondary_veins: Annotated[int, Field(ge=1, le=40)] = 9
    """Side veins on each side of the midrib."""
    secondary_angle_deg: Annotated[float, Field(ge=20, le=90)] = 55.0
    """Angle at which they leave the midrib; they curve to the tip as they come near the margin."""
    tertiary_spacing_mm: Positive | None = None
    """Mean distance of the veins that join side veins; None: 0.035 of the leaf's length. The finest net has a third
    of it."""
    texels_per_mm: Positive | None = None
    """Points of the raster per mm; None: what dots and mottling need, or less than
    that if it would be more than 4 million points."""
    underside_lightness: Annotated[float, Field(gt=0, le=3)] | None = None
    """Radiance of the underside relative to the upper side; None: 1.3 green, 1.05 near infrared."""
    underside_relief: Annotated[float, Field(ge=0, le=3)] = 1.25
    """Contrast of the veins on the underside relative to the upper side."""

    @property
    def settings(self) -> dict[str, float]:
        """Values of the fields that depend on the channel."""
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
                    f"veins, mottling and speckle together may reach radiances from {least:.3g} to {most:.3g}; lower "
                    "mean or contrasts to stay within [0, 1]"
                )
                raise ValueError(msg)
        return self

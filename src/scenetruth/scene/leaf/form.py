"""What a scene file may say of a leaf's form: its outline, and how the blade is bent."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from scenetruth.model import Finite, FrozenModel, Positive
from scenetruth.scene.leaf.lobes import LobeSide, lobe_sides, narrowest_lobe_mm
from scenetruth.scene.mesh import MeshModel

__all__ = ["LeafForm", "Petiole", "Serration", "Undulation"]

_MOST_TRIANGLES = 5_000_000
_WIDTHS = {"ovate": 0.62, "lanceolate": 0.28, "cordate": 0.85, "elliptic": 0.55, "palmate": 1.5}
_PARTS_OF_WIDTH = 4  # triangles across the blade, at least
_PARTS_OF_TOOTH = 4  # edges along a tooth, at least
_PARTS_OF_LOBE = 5  # triangles across a lobe, at least
_LONGEST_PETIOLE = 10  # times the blade: longer ones are stems, and fill a lattice with points that are not used
_NARROWEST_PALMATE = 0.8  # least width of a palmate leaf as a part of its length

Fraction = Annotated[float, Field(ge=0, le=1)]
Turn = Annotated[float, Field(gt=-360, lt=360, allow_inf_nan=False)]


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
    bend_along_deg: Turn = 0.0
    """Angle in degrees between base and tip of the midrib, which is a circular arc; positive curls the tip towards the
    upper side. The petiole continues the arc. Keeps lengths."""
    bend_across_deg: Turn = 0.0
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
    return lobe_sides(7 if lobes is None else lobes, 0.5 if cut is None else cut, tip or "acuminate", length, width)

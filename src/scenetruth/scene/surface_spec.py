"""The models of surfaces that follow a formula, and are meshed as finely as asked."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from scenetruth.model import Finite, FrozenModel, Positive

__all__ = ["CylinderMesh", "PlaneMesh", "ReliefMesh", "SaddleMesh", "SphereMesh", "StairsMesh"]

_MOST_TRIANGLES = 20_000_000
# A wave of which less is sampled is no wave any more.
_PIECES_PER_WAVE = 4


class PlaneMesh(FrozenModel):
    """A rectangle in the XY plane that faces the camera (normal -Z), centred on its origin."""

    kind: Literal["plane"]
    """``plane``."""
    size_mm: tuple[Positive, Positive]
    """Edge lengths along X and Y in mm."""
    resolution_mm: Positive | None = None
    """Longest edge of the triangles along X and Y in mm, for deformations within the plane; null for two triangles."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float | None, info: ValidationInfo) -> float | None:
        return value if value is None else _sheet_resolution(value, info)


class SphereMesh(FrozenModel):
    """A sphere about its origin, or the cap of it that faces the camera (about -Z)."""

    kind: Literal["sphere"]
    """``sphere``."""
    radius_mm: Positive
    """Its radius in mm."""
    cap_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """Angle from its middle to its rim as seen from the centre, at most 90; null for the full sphere."""
    resolution_mm: Positive = 0.5
    """Length of the triangles' edges in mm, about; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius = info.data.get("radius_mm")
        return value if radius is None else _resolution(value, radius, "radius_mm", 8 * 3.2 * radius**2)


class CylinderMesh(FrozenModel):
    """A round cylinder about the Y axis, centred on its origin."""

    kind: Literal["cylinder"]
    """``cylinder``."""
    radius_mm: Positive
    """Its radius in mm."""
    length_mm: Positive
    """Its length along Y in mm."""
    caps: bool = False
    """Whether discs close its two ends."""
    resolution_mm: Positive = 0.5
    """Longest edge of the triangles around and along it in mm; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius, length = info.data.get("radius_mm"), info.data.get("length_mm")
        if radius is None or length is None:
            return value
        return _resolution(value, radius, "radius_mm", 2 * 6.3 * radius * length)


class SaddleMesh(FrozenModel):
    """The saddle Z = curvature (X² - Y²) / 2 over a rectangle: a sheet with its upper side towards -Z."""

    kind: Literal["saddle"]
    """``saddle``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    curvature_per_mm: Finite
    """Curvature at the middle in 1/mm; positive: its left and right ends are farther from the camera."""
    resolution_mm: Positive = 0.5
    """Longest edge of the flat sheet's triangles along X and Y in mm."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        return _sheet_resolution(value, info)


class ReliefMesh(FrozenModel):
    """Waves Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y) over a rectangle: a sheet, upper side -Z."""

    kind: Literal["relief"]
    """``relief``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    amplitude_mm: Finite
    """Height of the crests above the middle plane in mm, towards the camera."""
    wavelength_mm: tuple[Positive | None, Positive | None]
    """Wavelengths λ_X and λ_Y in mm; null for a relief that does not change in this direction."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases φ_X and φ_Y at the origin in degrees."""
    resolution_mm: Positive = 0.5
    """Longest edge of the flat sheet's triangles along X and Y in mm; at most a quarter of a wavelength."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        waves = [length for length in info.data.get("wavelength_mm", ()) if length is not None]
        if waves and value > min(waves) / _PIECES_PER_WAVE:
            msg = f"must be at most a quarter of wavelength_mm, {min(waves) / _PIECES_PER_WAVE:g} mm"
            raise ValueError(msg)
        return _sheet_resolution(value, info)


class StairsMesh(FrozenModel):
    """Stairs of depth: treads side by side along X that face the camera (normal -Z), one behind the other.

    The origin is in the middle of their width and height, and halfway between the nearest and the farthest tread.
    """

    kind: Literal["stairs"]
    """``stairs``."""
    tread_mm: tuple[Positive, Positive]
    """Size of each tread along X and Y in mm."""
    steps_mm: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=10_000)]
    """How much farther than its left neighbour each tread stands, in mm; one number fewer than there are treads."""
    risers: bool = True
    """Whether upright faces join the treads; otherwise these hover side by side."""

    @field_validator("steps_mm")
    @classmethod
    def _real_steps(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        flat = [str(index) for index, step in enumerate(value) if step == 0]
        if flat:
            msg = f"steps must not be 0 (got one at index {', '.join(flat)}): join the treads instead"
            raise ValueError(msg)
        return value


def _sheet_resolution(value: float, info: ValidationInfo) -> float:
    size = info.data.get("size_mm")
    return value if size is None else _resolution(value, min(size), "the shorter of size_mm", 2 * size[0] * size[1])


def _resolution(value: float, longest_mm: float, name: str, twice_area: float) -> float:
    """Refuse meshes that are too coarse to show a form, or too fine for any memory."""
    if value > longest_mm:
        msg = f"must be at most {name}, {longest_mm:g} mm"
        raise ValueError(msg)
    triangles = twice_area / value**2
    if triangles > _MOST_TRIANGLES:
        msg = f"would make about {triangles:.2g} triangles, more than {_MOST_TRIANGLES:.0e}; make it coarser"
        raise ValueError(msg)
    return value

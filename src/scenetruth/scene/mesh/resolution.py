"""Checks of how finely a surface is meshed."""

from __future__ import annotations

from pydantic import ValidationInfo

__all__ = ["checked_resolution", "sheet_resolution"]

_MOST_TRIANGLES = 20_000_000


def sheet_resolution(value: float, info: ValidationInfo) -> float:
    """Refuse triangles that are longer than a sheet's shorter side, or too many."""
    size = info.data.get("size_mm")
    return (
        value if size is None else checked_resolution(value, min(size), "the shorter of size_mm", 2 * size[0] * size[1])
    )


def checked_resolution(value: float, longest_mm: float, name: str, twice_area: float) -> float:
    """Refuse meshes that are too coarse to show a form, or too fine for any memory."""
    if value > longest_mm:
        msg = f"must be at most {name}, {longest_mm:g} mm"
        raise ValueError(msg)
    triangles = twice_area / value**2
    if triangles > _MOST_TRIANGLES:
        msg = f"would make about {triangles:.2g} triangles, more than {_MOST_TRIANGLES:.0e}; make it coarser"
        raise ValueError(msg)
    return value

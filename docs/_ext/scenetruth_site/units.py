"""Units of fields, from their names: ``size_mm`` is in mm."""

from __future__ import annotations

__all__ = ["unit_of"]

# The longest suffix takes precedence: mm_per_frame2 before frame2.
_UNITS = {
    "mm_per_frame2": "mm per frame²",
    "mm_per_frame": "mm per frame",
    "mm_per_s": "mm/s",
    "deg_per_frame": "° per frame",
    "per_frame": "per frame",
    "per_hour": "per hour",
    "per_mm2": "per mm²",
    "per_mm": "per mm",
    "per_s": "per s",
    "dn_per_e": "DN per electron",
    "e_per_s": "electrons per s",
    "frames": "frames",
    "frame": "frames",
    "urad": "µrad",
    "lux": "lx",
    "deg": "°",
    "mm": "mm",
    "um": "µm",
    "px": "px",
    "ppm": "ppm",
    "dn": "DN",
    "h": "hours",
    "s": "s",
    "e": "electrons",
}


def unit_of(name: str) -> str:
    """Return the unit in the suffix of a field name, or an empty string.

    Parameters
    ----------
    name
        The name of the field.

    Examples
    --------
    >>> unit_of("velocity_mm_per_frame"), unit_of("exposure_time_s"), unit_of("kind")
    ('mm per frame', 's', '')
    """
    for ending, unit in sorted(_UNITS.items(), key=lambda item: -len(item[0])):
        if name.endswith(f"_{ending}") and name != ending:
            return unit
    return ""

"""Growth as a map: the area of every piece of a sheet grows by exactly the rate that is given for it."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.scene.deformation_spec import Growth
from scenetruth.scene.jets import Field, values_of
from scenetruth.scene.jets.smooth import exp_quotient, sinc_root
from scenetruth.scene.motion import PointMap, Points

__all__ = ["growth_map", "growth_problem"]

_LARGEST_EXPONENT = 20.0


def growth_map(entry: Growth, hours_per_frame: float, extent_mm: tuple[float, float]) -> PointMap:
    """Return the map of growth.

    With R(t) the rate integrated over time, and g(X) linear, growth alike in all directions is the conformal map
    f(z) = ∫ exp(g R / 2) dz of z = X + i Y: its local area grows by |f'|² = exp(g R), and log |f'| is harmonic because
    g is linear. Other growth is X' = ∫ exp(p g R) dX, Y' = Y exp((1 - p) g R), with the Jacobian exp(g R) again.

    Parameters
    ----------
    entry
        The growth.
    hours_per_frame
        Time between frames in hours.
    extent_mm
        Least and largest X of the mesh, mm.
    """
    at_origin, slope = _gradient(entry, extent_mm)

    def grow(points: Points, t: Field) -> Points:
        x, y, z = points
        grown = _grown(entry, hours_per_frame, t)
        if entry.along_share is None:
            scale = np.exp(0.5 * at_origin * grown)
            x, y = _conformal(x, y, 0.5 * slope * grown) if slope else (x, y)
            return x * scale, y * scale, z * scale if entry.solid else z
        along, across = entry.along_share, 1 - entry.along_share
        length, width = x * np.exp(along * at_origin * grown), y * np.exp(across * at_origin * grown)
        if slope:
            length = length * exp_quotient(along * slope * grown * x)
            width = width * np.exp(across * slope * grown * x)
        return length, width, z

    return grow


def growth_problem(
    entry: Growth, hours_per_frame: float, extent_mm: tuple[float, float], points: Points, t: Field
) -> tuple[str, str]:
    """Return the field that makes growth unfit for points at a time, and why; or two empty strings."""
    if entry.base_to_tip[0] != entry.base_to_tip[1]:
        base, tip = _ends(entry, extent_mm)
        if tip <= base:
            return "tip_mm", f"growth has no length to change over: base {base:g} mm, tip {tip:g} mm"
    at_origin, slope = _gradient(entry, extent_mm)
    grown = float(np.max(np.abs(_grown(entry, hours_per_frame, t) * (at_origin + slope * values_of(points[0])))))
    if not grown <= _LARGEST_EXPONENT:
        return "rate_per_hour", f"grows or shrinks by a factor of exp({grown:.4g}) within the frames; make it slower"
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

"""The form of a leaf: a map of the flat sheet to the blade, in plain formulas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenetruth.scene.leaf.form import LeafForm

__all__ = ["LeafShape", "shape_of"]

Points = tuple[Any, Any, Any]


@dataclass(frozen=True)
class LeafShape:
    """Undulation, fold, bending across and bending along, in this order; all smooth.

    Points are fields (x, y, z): arrays of any floating type, or anything else that obeys NumPy's arithmetic.

    Parameters
    ----------
    wave_per_mm
        Height of the waves over the square of the distance from the midrib, 1/mm.
    wave_number_per_mm
        Angular wave number along the midrib, rad/mm.
    fold_rad
        Angle between each half and the flat; positive towards the upper side (-Z).
    fold_width_mm
        Width of the rounding.
    across_per_mm, along_per_mm
        Curvatures; positive towards the upper side.
    """

    wave_per_mm: float = 0.0
    wave_number_per_mm: float = 0.0
    fold_rad: float = 0.0
    fold_width_mm: float = 1.0
    across_per_mm: float = 0.0
    along_per_mm: float = 0.0

    def __call__(self, points: Points, t: Any) -> Points:
        """Return where points of the sheet are; the time does not count."""
        x, y, z = points
        height = -z
        if self.wave_per_mm != 0:
            height = height + self.wave_per_mm * y * y * np.sin(self.wave_number_per_mm * x)
        if self.fold_rad != 0:
            y, height = _folded(y, height, self.fold_rad, self.fold_width_mm)
        if self.across_per_mm != 0:
            y, height = _rolled(y, height, self.across_per_mm)
        if self.along_per_mm != 0:
            x, height = _rolled(x, height, self.along_per_mm)
        return x, y, -height


def _rolled(along: Any, height: Any, curvature: float) -> tuple[Any, Any]:
    """Bend a sheet on a circular arc; what stands off the sheet stays normal to it."""
    turn = curvature * along
    half = np.sin(turn / 2)
    return np.sin(turn) / curvature - height * np.sin(turn), 2 * half * half / curvature + height * np.cos(turn)


def _folded(along: Any, height: Any, angle: float, width: float) -> tuple[Any, Any]:
    """Fold a sheet into a hyperbola whose asymptotes rise by an angle; far from the fold lengths are kept."""
    rounding = width / 2
    # Less the rounding itself: the fold's own line stays where it is.
    rise = np.sqrt(along * along + rounding * rounding) - rounding
    return along * np.cos(angle), height + np.sin(angle) * rise


def shape_of(leaf: LeafForm) -> LeafShape:
    """Return the form that a scene asks for."""
    half = leaf.full_width_mm / 2
    waves = leaf.undulation
    fold_width = leaf.full_width_mm / 10 if leaf.fold_width_mm is None else leaf.fold_width_mm
    return LeafShape(
        wave_per_mm=0.0 if waves is None else waves.amplitude_mm / half**2,
        wave_number_per_mm=0.0 if waves is None else 2 * float(np.pi) * waves.waves_per_side / leaf.length_mm,
        fold_rad=float(np.radians(leaf.fold_deg)) / 2,
        fold_width_mm=fold_width,
        across_per_mm=float(np.radians(leaf.bend_across_deg)) / (2 * half),
        along_per_mm=float(np.radians(leaf.bend_along_deg)) / leaf.length_mm,
    )

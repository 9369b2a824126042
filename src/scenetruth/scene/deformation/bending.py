"""Bending over a cylinder, by a formula that needs no exception where nothing is bent."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Finite, Positive
from scenetruth.scene.deformation.base import DeformationModel, Surroundings
from scenetruth.scene.jets import Field, values_of, where
from scenetruth.scene.jets.smooth import sinc_root
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Bending"]


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

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of a bend.

        With u the distance from where it begins, and θ = κ u the angle there, a point goes to the place of u on an arc,
        (sin θ, -(1 - cos θ)) / κ, and from there by its Z along the arc's normal (sin θ, cos θ).
        """

        def bend(points: Points, t: Field) -> Points:
            x, y, z = points
            before, u, beyond = _parts(y if self.across else x, self)
            angle = _curvature(self, t) * u
            sine, cosine = np.sin(angle), np.cos(angle)
            half = sinc_root(angle * angle * 0.25)
            flat = before + u * sinc_root(angle * angle) + beyond * cosine + z * sine
            z = z * cosine - 0.5 * u * angle * half * half - beyond * sine
            return (x, flat, z) if self.across else (flat, y, z)

        return bend

    def problem(self, around: Surroundings, points: Points, t: Field) -> tuple[str, str]:
        """Return the field that makes a bend unfit for points at a time, and why; or two empty strings."""
        _, u, _ = _parts(points[1] if self.across else points[0], self)
        curvature = float(np.ravel(_curvature(self, t))[0])
        turned = float(np.rad2deg(np.max(np.abs(curvature * u))))
        if turned >= 360:
            return "angle_deg", f"bends the sheet by {turned:.6g} degrees, into itself; make it less than 360"
        tightest = float(np.min(1 + curvature * np.where(u == 0, 0, points[2])))
        if tightest <= 0:
            return "angle_deg", (
                f"the radius of the bend, {abs(1 / curvature):.6g} mm, is less than what stands off the plane Z = 0; "
                "make length_mm larger or the angle smaller"
            )
        return "", ""


def _curvature(entry: Bending, t: Field) -> Any:
    """Return the curvature in 1/mm."""
    return np.pi / 180 / entry.length_mm * value_at(entry.angle_deg, t)


def _parts(x: Any, entry: Bending) -> tuple[Any, Any, Any]:
    """Split a coordinate into what lies before the bend, in it and beyond it; across, to either side of zero."""
    # Zero belongs to one side, so that a bend from zero on is one smooth piece there.
    side = np.where(values_of(x) < 0, -1, 1) if entry.across else 1
    distance = x * side - entry.from_mm
    at, length = values_of(distance), entry.length_mm
    bent = where(at < 0, 0.0, where(at > length, length, distance)) * side
    beyond = where(at > length, distance - length, 0.0) * side
    return x - bent - beyond, bent, beyond

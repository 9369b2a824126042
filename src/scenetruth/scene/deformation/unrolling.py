"""A roll that opens: a sheet rolled up in a logarithmic spiral beyond a front that moves."""

from __future__ import annotations

from math import pi
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field as Described
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Positive
from scenetruth.scene.deformation.base import DeformationModel, Surroundings
from scenetruth.scene.jets import Field, values_of, where
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.time_curve import TimeCurve, value_at

__all__ = ["Unrolling", "roll_problem"]


class Unrolling(DeformationModel):
    """A sheet rolled up beyond a front that moves along X, isometric for flat sheets.

    The roll is a logarithmic spiral, the curve whose radius of curvature falls steadily along it: radius_mm -
    tightening (distance from the front, measured on the sheet). It lies on one side of the sheet and never meets
    itself. Points off Z = 0 keep their distance from the rolled plane Z = 0.
    """

    kind: Literal["unrolling"]
    """``unrolling``."""
    length_mm: Positive
    """X up to which there is material, at all times."""
    front_mm: TimeCurve
    """X of the front: the sheet is as it was up to here, and rolled up beyond."""
    radius_mm: Positive
    """Radius of curvature of the roll at the front."""
    tightening: Annotated[float, Described(ge=0, lt=1, allow_inf_nan=False, validate_default=True)] = 0.02
    """Loss of radius per length of the sheet; 0 is a circle, which may not close."""
    side: Literal["upper", "lower"] = "upper"
    """Side that the roll lies on: ``upper`` is -Z."""

    @field_validator("tightening")
    @classmethod
    def _free(cls, value: float, info: ValidationInfo) -> float:
        length, front, radius = (info.data.get(name) for name in ("length_mm", "front_mm", "radius_mm"))
        if length is None or front is None or radius is None:
            return value
        at_zero = float(np.ravel(value_at(front, np.zeros(1)))[0])
        problem = roll_problem(length - at_zero, radius, value)
        if problem:
            msg = f"{problem} at t = 0"
            raise ValueError(msg)
        return value

    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of a roll that opens.

        At the distance u from the front the radius is ρ = ρ0 - c u and the angle θ = ∫ du / ρ = -log(1 - c u / ρ0) / c,
        so that the curve ∫ exp(i θ) du is ρ0 ((ρ / ρ0) exp(i θ) - 1) / (i - c).
        """
        radius, c = self.radius_mm, self.tightening
        sign = -1.0 if self.side == "upper" else 1.0

        def roll(points: Points, t: Field) -> Points:
            x, y, z = points
            u = _rolled(x, self, t)
            angle = _angle(u, self)
            sine, cosine = np.sin(angle), np.cos(angle)
            shrunk = 1 - (c / radius) * u
            real, imaginary = shrunk * cosine - 1, shrunk * sine
            along = radius / (1 + c * c) * (imaginary - c * real)
            up = radius / (1 + c * c) * (-1 * real - c * imaginary)
            return x - u + along - sign * (z * sine), y, sign * up + z * cosine

        return roll

    def problem(self, around: Surroundings, points: Points, t: Field) -> tuple[str, str]:
        """Return the field that makes a roll unfit for points at a time, and why; or two empty strings."""
        front = float(np.ravel(value_at(self.front_mm, t))[0])
        problem = roll_problem(self.length_mm - front, self.radius_mm, self.tightening)
        if problem:
            return "front_mm", problem
        end = float(np.max(points[0]))
        if end > self.length_mm * (1 + 1e-9):
            return "length_mm", f"is less than where the mesh ends, {end:.6g} mm"
        u = _rolled(points[0], self, t)
        rolled = float(np.max(u))
        if rolled == 0:
            return "", ""
        low, high = float(np.min(points[2][u > 0])), float(np.max(points[2][u > 0]))
        c, inner = self.tightening, self.radius_mm - self.tightening * rolled
        towards_inside = -low if self.side == "upper" else high
        # Between turns there is at least the distance to the next turn outside, where the roll is tightest.
        room = inner * np.expm1(2 * np.pi * c) / (1 + c * c)
        closed = float(_angle(np.array([rolled]), self)[0]) >= 2 * np.pi
        if towards_inside >= inner or (closed and high - low >= room):
            space = min(inner, room) if closed else inner
            return "radius_mm", (
                f"self-intersecting unrolling: the sheet reaches over {high - low:.6g} mm across its plane Z = 0, but "
                f"the roll has room for {space:.6g} mm"
            )
        return "", ""


def roll_problem(rolled_mm: float, radius_mm: float, tightening: float) -> str:
    """Say why a length of a sheet cannot be rolled up, or return nothing."""
    if tightening == 0 and rolled_mm >= 2 * pi * radius_mm:
        turn = 2 * pi * radius_mm
        return f"self-intersecting unrolling: {rolled_mm:.6g} mm close a circle of {turn:.6g} mm; tighten the roll"
    if tightening * rolled_mm >= radius_mm:
        most = radius_mm / tightening
        return (
            f"self-intersecting unrolling: the radius falls to zero within {most:.6g} mm, but {rolled_mm:.6g} mm are "
            "rolled up; make radius_mm larger or tightening smaller"
        )
    return ""


def _rolled(x: Any, entry: Unrolling, t: Field) -> Any:
    """Return the distance from the front, zero before it."""
    u = x - value_at(entry.front_mm, t)
    return where(values_of(u) > 0, u, 0.0)


def _angle(u: Any, entry: Unrolling) -> Any:
    c = entry.tightening
    return u / entry.radius_mm if c == 0 else np.log1p(-c / entry.radius_mm * u) / -c

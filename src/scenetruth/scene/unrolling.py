"""A roll that opens: a sheet rolled up in a logarithmic spiral beyond a front that moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.scene.deformation_spec import Unrolling, roll_problem
from scenetruth.scene.jets import Field, values_of, where
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.time_curve import value_at

__all__ = ["unrolling_map", "unrolling_problem"]


def unrolling_map(entry: Unrolling) -> PointMap:
    """Return the map of a roll that opens.

    At the distance u from the front the radius is ρ = ρ0 - c u and the angle θ = ∫ du / ρ = -log(1 - c u / ρ0) / c, so
    that the curve ∫ exp(i θ) du is ρ0 ((ρ / ρ0) exp(i θ) - 1) / (i - c).
    """
    radius, c = entry.radius_mm, entry.tightening
    sign = -1.0 if entry.side == "upper" else 1.0

    def roll(points: Points, t: Field) -> Points:
        x, y, z = points
        u = _rolled(x, entry, t)
        angle = _angle(u, entry)
        sine, cosine = np.sin(angle), np.cos(angle)
        shrunk = 1 - (c / radius) * u
        real, imaginary = shrunk * cosine - 1, shrunk * sine
        along = radius / (1 + c * c) * (imaginary - c * real)
        up = radius / (1 + c * c) * (-1 * real - c * imaginary)
        return x - u + along - sign * (z * sine), y, sign * up + z * cosine

    return roll


def unrolling_problem(entry: Unrolling, points: Points, t: Field) -> tuple[str, str]:
    """Return the field that makes a roll unfit for points at a time, and why; or two empty strings."""
    front = float(np.ravel(value_at(entry.front_mm, t))[0])
    problem = roll_problem(entry.length_mm - front, entry.radius_mm, entry.tightening)
    if problem:
        return "front_mm", problem
    end = float(np.max(points[0]))
    if end > entry.length_mm * (1 + 1e-9):
        return "length_mm", f"is less than where the mesh ends, {end:.6g} mm"
    u = _rolled(points[0], entry, t)
    rolled = float(np.max(u))
    if rolled == 0:
        return "", ""
    low, high = float(np.min(points[2][u > 0])), float(np.max(points[2][u > 0]))
    c, inner = entry.tightening, entry.radius_mm - entry.tightening * rolled
    towards_inside = -low if entry.side == "upper" else high
    # Between turns there is at least the distance to the next turn outside, where the roll is tightest.
    room = inner * np.expm1(2 * np.pi * c) / (1 + c * c)
    closed = float(_angle(np.array([rolled]), entry)[0]) >= 2 * np.pi
    if towards_inside >= inner or (closed and high - low >= room):
        space = min(inner, room) if closed else inner
        return "radius_mm", (
            f"self-intersecting unrolling: the sheet reaches over {high - low:.6g} mm across its plane Z = 0, but the "
            f"roll has room for {space:.6g} mm"
        )
    return "", ""


def _rolled(x: Any, entry: Unrolling, t: Field) -> Any:
    """Return the distance from the front, zero before it."""
    u = x - value_at(entry.front_mm, t)
    return where(values_of(u) > 0, u, 0.0)


def _angle(u: Any, entry: Unrolling) -> Any:
    c = entry.tightening
    return u / entry.radius_mm if c == 0 else np.log1p(-c / entry.radius_mm * u) / -c

"""Motions: maps of points that depend on time, each one formula for positions and all derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene import deformation_spec, motion_spec
from scenetruth.scene.jets import Field, Jet
from scenetruth.scene.time_curve import value_at

__all__ = [
    "Moved",
    "PointMap",
    "Points",
    "compose",
    "deformation_map",
    "motion_map",
    "motions_about",
    "pose_map",
    "turn",
]

Points = tuple[Any, Any, Any]
"""Coordinates X, Y, Z of n points in mm: three fields (`scenetruth.scene.jets.Field`)."""


class PointMap(Protocol):
    """A map of points that depends on time, written in plain NumPy."""

    def __call__(self, points: Points, t: Field) -> Points:
        """Move points.

        Parameters
        ----------
        points
            Coordinates before the motion, mm: arrays of any precision, or jets if derivatives are wanted.
        t
            Time in frames, of the same kind, shape (1,).

        Returns
        -------
        tuple
            Coordinates after it.
        """
        ...


@dataclass(frozen=True, eq=False)
class Moved:
    """Points at one time.

    Parameters
    ----------
    positions_mm
        Positions, shape (n, 3), mm.
    velocities
        Velocities, shape (n, 3), mm per frame.
    accelerations
        Accelerations, shape (n, 3), mm per frame squared.
    """

    positions_mm: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]


def compose(maps: Sequence[PointMap], points_mm: NDArray[np.float64], t: float) -> Moved:
    """Apply maps one after the other to points that rest.

    Parameters
    ----------
    maps
        The maps, first applied first.
    points_mm
        Positions before all of them, shape (n, 3), mm.
    t
        Time in frames, any real number.
    """
    points: Points = tuple(Jet.constant(column, 1) for column in np.ascontiguousarray(points_mm.T))  # type: ignore[assignment]
    time = Jet.variable(np.array([float(t)]), 0, 1)
    for item in maps:
        points = item(points, time)
    return moved_of(points, len(points_mm))


def moved_of(points: Points, count: int) -> Moved:
    """Return positions, velocities and accelerations from coordinates that are jets in time."""
    rows = [np.broadcast_to(field.coefficients, (3, count)) for field in points]
    return Moved(*(np.stack([row[order] for row in rows], axis=1) for order in range(3)))


def motions_about(entries: Sequence[motion_spec.Motion], position_mm: tuple[float, float, float]) -> list[PointMap]:
    """Return motions in the order in which they apply; rotations without a point turn about a position."""
    return [motion_map(entry, position_mm) for entry in entries]


def motion_map(entry: motion_spec.Motion, position_mm: tuple[float, float, float]) -> PointMap:
    """Return the map of one motion in the world; what has no point of its own turns about a position."""
    if isinstance(entry, motion_spec.ConstantVelocity):
        return _translation(entry.velocity_mm_per_frame)
    centre = position_mm if entry.point_mm is None else entry.point_mm
    rate = np.deg2rad(entry.rate_deg_per_frame)
    return lambda points, t: turn(points, entry.axis, rate * t, centre)


def deformation_map(entry: deformation_spec.Deformation) -> PointMap:
    """Return the map of one deformation in an object's own frame."""
    return lambda points, t: turn(points, entry.axis, np.pi / 180 * value_at(entry.angle_deg, t), entry.point_mm)


def pose_map(
    position_mm: tuple[float, float, float], rotations: Sequence[tuple[tuple[float, float, float], float]]
) -> PointMap:
    """Return the map from an object's own frame to the world: rotations (axis, angle in degrees), then a shift."""

    def place(points: Points, t: Field) -> Points:
        for axis, angle_deg in rotations:
            points = turn(points, axis, np.deg2rad(angle_deg), (0.0, 0.0, 0.0))
        x, y, z = points
        return x + position_mm[0], y + position_mm[1], z + position_mm[2]

    return place


def turn(points: Points, axis: tuple[float, float, float], angle: Any, centre: tuple[float, float, float]) -> Points:
    """Turn points about an axis through a centre (right-hand rule, Rodrigues' formula).

    Parameters
    ----------
    points
        Coordinates, mm.
    axis
        Direction of the axis, of any length.
    angle
        Angle in rad: a number or a field.
    centre
        Point on the axis, mm.
    """
    nx, ny, nz = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    x, y, z = (field - at for field, at in zip(points, centre, strict=True))
    sine, cosine = np.sin(angle), np.cos(angle)
    along = (nx * x + ny * y + nz * z) * (1 - cosine)
    return (
        x * cosine + (ny * z - nz * y) * sine + nx * along + centre[0],
        y * cosine + (nz * x - nx * z) * sine + ny * along + centre[1],
        z * cosine + (nx * y - ny * x) * sine + nz * along + centre[2],
    )


def _translation(velocity: tuple[float, float, float]) -> PointMap:
    def move(points: Points, t: Field) -> Points:
        x, y, z = points
        return x + velocity[0] * t, y + velocity[1] * t, z + velocity[2] * t

    return move

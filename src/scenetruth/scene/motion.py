"""Motions: maps of points that depend on time, each one formula for positions and all derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene import motion_spec
from scenetruth.scene.jets import Field, Jet
from scenetruth.scene.smooth import sinc_root
from scenetruth.scene.time_curve import SplineThrough, value_at

__all__ = [
    "Moved",
    "PointMap",
    "Points",
    "apply",
    "compose",
    "motion_map",
    "motions_about",
    "moved_of",
    "pose_map",
    "turn",
    "turn_by",
]

Points = tuple[Any, Any, Any]
"""Coordinates X, Y, Z of n points in mm: three fields (`scenetruth.scene.jets.Field`)."""

# Points mapped at once: what a map keeps in between, some jets of ten numbers a point, fits into the cache.
_BLOCK = 4096


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
    return moved_of(apply(maps, points, time), len(points_mm))


def apply(maps: Sequence[PointMap], points: Points, t: Field) -> Points:
    """Apply maps one after the other to jets of n points, in blocks that stay in the processor's cache.

    Parameters
    ----------
    maps
        The maps, first applied first.
    points
        Coordinates, three jets of n values, or of one that stands for all.
    t
        Time, a jet of one value.
    """
    count = max(len(field) for field in points)
    if not maps or count <= _BLOCK:
        for item in maps:
            points = item(points, t)
        return points
    results = [np.empty((len(field.coefficients), count)) for field in points]
    for low in range(0, count, _BLOCK):
        part: Points = tuple(  # type: ignore[assignment]
            field if len(field) == 1 else Jet(field.coefficients[:, low : low + _BLOCK]) for field in points
        )
        for item in maps:
            part = item(part, t)
        for result, field in zip(results, part, strict=True):
            result[:, low : low + _BLOCK] = field.coefficients
    return Jet(results[0]), Jet(results[1]), Jet(results[2])


def moved_of(points: Points, count: int) -> Moved:
    """Return positions, velocities and accelerations from coordinates that are jets in time."""
    rows = [np.broadcast_to(field.coefficients, (3, count)) for field in points]
    return Moved(*(np.stack([row[order] for row in rows], axis=1) for order in range(3)))


def motions_about(entries: Sequence[motion_spec.Motion], position_mm: tuple[float, float, float]) -> list[PointMap]:
    """Return motions in the order in which they apply; rotations without a point turn about a position."""
    return [motion_map(entry, position_mm) for entry in entries]


def motion_map(entry: motion_spec.Motion, position_mm: tuple[float, float, float]) -> PointMap:
    """Return the map of one motion in the world; what has no point of its own turns about a position."""
    make = _MAPS[type(entry)]
    result: PointMap = make(entry, position_mm)
    return result


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


def turn_by(points: Points, vector_rad: Points, centre: tuple[float, float, float]) -> Points:
    """Turn points by a rotation vector, which may vanish, about a centre.

    Parameters
    ----------
    points
        Coordinates, mm.
    vector_rad
        The axis, its length the angle in rad (right-hand rule): three fields.
    centre
        Point that stays in place, mm.
    """
    x, y, z = (field - at for field, at in zip(points, centre, strict=True))
    u, v, w = vector_rad
    square = u * u + v * v + w * w
    half = sinc_root(square * 0.25)
    once, twice = sinc_root(square), half * half * 0.5
    i, j, k = v * z - w * y, w * x - u * z, u * y - v * x
    return (
        x + once * i + twice * (v * k - w * j) + centre[0],
        y + once * j + twice * (w * i - u * k) + centre[1],
        z + once * k + twice * (u * j - v * i) + centre[2],
    )


Vector = tuple[float, float, float]


def _velocity(entry: motion_spec.ConstantVelocity, _: Vector) -> PointMap:
    velocity = entry.velocity_mm_per_frame

    def move(points: Points, t: Field) -> Points:
        x, y, z = points
        return x + velocity[0] * t, y + velocity[1] * t, z + velocity[2] * t

    return move


def _acceleration(entry: motion_spec.Acceleration, _: Vector) -> PointMap:
    velocity, acceleration = entry.velocity_mm_per_frame, entry.acceleration_mm_per_frame2

    def move(points: Points, t: Field) -> Points:
        shifts = (v * t + (a / 2) * (t * t) for v, a in zip(velocity, acceleration, strict=True))
        x, y, z = (field + shift for field, shift in zip(points, shifts, strict=True))
        return x, y, z

    return move


def _shift(entry: motion_spec.Shift, _: Vector) -> PointMap:
    direction = np.asarray(entry.direction) / np.linalg.norm(entry.direction)

    def move(points: Points, t: Field) -> Points:
        distance = value_at(entry.distance_mm, t)
        x, y, z = (field + n * distance for field, n in zip(points, direction, strict=True))
        return x, y, z

    return move


def _rotation(entry: motion_spec.ConstantRotation, position_mm: Vector) -> PointMap:
    centre = position_mm if entry.point_mm is None else entry.point_mm
    rate = np.deg2rad(entry.rate_deg_per_frame)
    return lambda points, t: turn(points, entry.axis, rate * t, centre)


def _turn(entry: motion_spec.Turn, position_mm: Vector) -> PointMap:
    centre = position_mm if entry.point_mm is None else entry.point_mm
    return lambda points, t: turn(points, entry.axis, np.pi / 180 * value_at(entry.angle_deg, t), centre)


def _nutation(entry: motion_spec.Nutation, position_mm: Vector) -> PointMap:
    centre = position_mm if entry.point_mm is None else entry.point_mm
    direction = np.asarray(entry.direction) / np.linalg.norm(entry.direction)
    aside = np.asarray(entry.towards) - (direction @ np.asarray(entry.towards)) * direction
    first = np.cross(direction, aside / np.linalg.norm(aside))
    second = np.cross(direction, first)
    amplitude_first, amplitude_second = np.deg2rad(entry.amplitudes_deg)

    def move(points: Points, t: Field) -> Points:
        phase = 2 * np.pi / entry.period_frames * t + np.deg2rad(entry.phase_deg)
        cosine, sine = amplitude_first * np.cos(phase), amplitude_second * np.sin(phase)
        u, v, w = (one * cosine + other * sine for one, other in zip(first, second, strict=True))
        return turn_by(points, (u, v, w), centre)

    return move


def _keyframes(entry: motion_spec.Keyframes, position_mm: Vector) -> PointMap:
    centre = position_mm if entry.point_mm is None else entry.point_mm
    shifts = _splines(entry.times_frames, entry.positions_mm, 1.0)
    turns = _splines(entry.times_frames, entry.rotations_deg, np.pi / 180)

    def move(points: Points, t: Field) -> Points:
        if turns:
            points = turn_by(points, (turns[0](t), turns[1](t), turns[2](t)), centre)
        if shifts:
            points = (points[0] + shifts[0](t), points[1] + shifts[1](t), points[2] + shifts[2](t))
        return points

    return move


def _splines(times: Sequence[float], values: Sequence[Vector] | None, unit: float) -> list[SplineThrough]:
    if values is None:
        return []
    return [SplineThrough(times, column) for column in np.asarray(values, dtype=np.float64).T * unit]


_MAPS: dict[type, Callable[[Any, Vector], PointMap]] = {
    motion_spec.ConstantVelocity: _velocity,
    motion_spec.ConstantRotation: _rotation,
    motion_spec.Acceleration: _acceleration,
    motion_spec.Shift: _shift,
    motion_spec.Turn: _turn,
    motion_spec.Nutation: _nutation,
    motion_spec.Keyframes: _keyframes,
}

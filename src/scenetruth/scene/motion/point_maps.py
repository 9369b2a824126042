"""Time-dependent point maps: base model of motions, chains with derivatives, rotations and poses."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.taylor import Jet, JetField, rotate_jets, sinc_root
from scenetruth.validated_model import FrozenModel, Vector3

__all__ = [
    "MotionModel",
    "MovedPoints",
    "PointMap",
    "Points",
    "apply",
    "compose",
    "pose_map",
    "rotate_points",
    "rotate_points_by_vector",
    "to_moved_points",
]


Points = tuple[Any, Any, Any]
"""Coordinates X, Y, Z of n points in mm: three fields (`scenetruth.scene.taylor.JetField`)."""


class PointMap(Protocol):
    """Time-dependent map of points, written in plain NumPy."""

    def __call__(self, points: Points, t: JetField) -> Points:
        """Map coordinates in mm at time t in frames, shape (1,): arrays of any precision, or jets for derivatives."""
        ...


@dataclass(frozen=True, eq=False)
class MovedPoints:
    """Positions in mm, velocities in mm/frame and accelerations in mm/frame² of points at one time, shape (n, 3)."""

    positions_mm: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]


class MotionModel(FrozenModel):
    """Base class of motions, defined by a formula for positions; derivatives are computed automatically."""

    kind: str
    """Type of the motion."""

    @abstractmethod
    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map of the motion; ``position_mm`` is the default centre of rotations."""


_BLOCK = 4096  # block size of the maps, such that intermediate jets fit into the cache


def compose(maps: Sequence[PointMap], points_mm: NDArray[np.float64], t: float) -> MovedPoints:
    """Apply maps in order to points at rest, shape (n, 3), mm."""
    points: Points = tuple(Jet.constant(column, 1) for column in np.ascontiguousarray(points_mm.T))  # type: ignore[assignment]
    time = Jet.variable(np.array([float(t)]), 0, 1)
    return to_moved_points(apply(maps, points, time), len(points_mm))


def apply(maps: Sequence[PointMap], points: Points, t: JetField) -> Points:
    """Apply maps in order to jets of n points, in blocks that fit into the processor cache."""
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


def to_moved_points(points: Points, count: int) -> MovedPoints:
    """Return positions, velocities and accelerations from coordinates that are jets in time."""
    rows = [np.broadcast_to(field.coefficients, (3, count)) for field in points]
    return MovedPoints(*(np.stack([row[order] for row in rows], axis=1) for order in range(3)))


def pose_map(
    position_mm: tuple[float, float, float], rotations: Sequence[tuple[tuple[float, float, float], float]]
) -> PointMap:
    """Return the map from the object frame to the world: rotations (axis, angle in degrees), then translation."""

    def place(points: Points, t: JetField) -> Points:
        for axis, angle_deg in rotations:
            points = rotate_points(points, axis, np.deg2rad(angle_deg), (0.0, 0.0, 0.0))
        x, y, z = points
        return x + position_mm[0], y + position_mm[1], z + position_mm[2]

    return place


def rotate_points(
    points: Points, axis: tuple[float, float, float], angle: Any, centre: tuple[float, float, float]
) -> Points:
    """Rotate points (mm) about an axis through a centre by an angle in rad (right-hand rule, Rodrigues' formula)."""
    nx, ny, nz = unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    quick = rotate_jets(points, unit, angle, centre)
    if quick is not None:
        return quick
    x, y, z = (field - at for field, at in zip(points, centre, strict=True))
    sine, cosine = np.sin(angle), np.cos(angle)
    along = (nx * x + ny * y + nz * z) * (1 - cosine)
    return (
        x * cosine + (ny * z - nz * y) * sine + nx * along + centre[0],
        y * cosine + (nz * x - nx * z) * sine + ny * along + centre[1],
        z * cosine + (nx * y - ny * x) * sine + nz * along + centre[2],
    )


def rotate_points_by_vector(points: Points, vector_rad: Points, centre: tuple[float, float, float]) -> Points:
    """Rotate points (mm) about a centre by a rotation vector in rad, which may vanish (right-hand rule)."""
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

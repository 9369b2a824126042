"""Motions: position and velocity of points at any real time, analytically."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.scene import spec

__all__ = ["PointMotion", "compose", "motions_about", "motions_of", "pose_points"]

Points = NDArray[np.float64]


class PointMotion(Protocol):
    """A map of points that depends on time."""

    def __call__(self, points: Points, velocities: Points, t: float) -> tuple[Points, Points]:
        """Move points that already move.

        Parameters
        ----------
        points
            Positions at time t before this motion, shape (n, 3), mm.
        velocities
            Their time derivatives, shape (n, 3), mm per frame.
        t
            Time in frames.

        Returns
        -------
        tuple
            Positions and their time derivatives after this motion.
        """
        ...


def pose_points(pose: spec.Pose, points_mm: Points) -> Points:
    """Return points of an object's own frame in the world, at t = 0."""
    points = points_mm
    for rotation in pose.rotations:
        points = _rotation(rotation.axis, np.deg2rad(rotation.angle_deg)).apply(points)
    return np.asarray(points + np.asarray(pose.position_mm))


def motions_of(item: spec.SceneObject) -> list[PointMotion]:
    """Return the motions of an object, in the order in which they apply."""
    return motions_about(item.motion, item.pose.position_mm)


def motions_about(entries: Sequence[spec.Motion], position_mm: tuple[float, float, float]) -> list[PointMotion]:
    """Return motions in the order in which they apply; rotations without a point turn about a position."""
    return [_motion(entry, position_mm) for entry in entries]


def compose(motions: Sequence[PointMotion], points_mm: Points, t: float) -> tuple[Points, Points]:
    """Apply motions one after the other to points that rest.

    Parameters
    ----------
    motions
        The motions, first applied first.
    points_mm
        World positions at t = 0, shape (n, 3), mm.
    t
        Time in frames, any real number.

    Returns
    -------
    tuple
        World positions in mm and velocities in mm per frame at time t, shape (n, 3) each.
    """
    points, velocities = points_mm, np.zeros_like(points_mm)
    for motion in motions:
        points, velocities = motion(points, velocities, t)
    return points, velocities


def _motion(entry: spec.ConstantVelocity | spec.ConstantRotation, position: tuple[float, float, float]) -> PointMotion:
    if isinstance(entry, spec.ConstantVelocity):
        return _translation(np.asarray(entry.velocity_mm_per_frame))
    return _turning(
        np.asarray(entry.axis) / np.linalg.norm(entry.axis),
        np.deg2rad(entry.rate_deg_per_frame),
        np.asarray(position if entry.point_mm is None else entry.point_mm),
    )


def _translation(velocity: NDArray[np.float64]) -> PointMotion:
    def move(points: Points, velocities: Points, t: float) -> tuple[Points, Points]:
        return points + velocity * t, velocities + velocity

    return move


def _turning(axis: NDArray[np.float64], rate: float, centre: NDArray[np.float64]) -> PointMotion:
    def move(points: Points, velocities: Points, t: float) -> tuple[Points, Points]:
        turn = Rotation.from_rotvec(axis * (rate * t))
        arm = turn.apply(points - centre)
        return arm + centre, np.cross(axis * rate, arm) + turn.apply(velocities)

    return move


def _rotation(axis: Sequence[float], angle: float) -> Rotation:
    direction = np.asarray(axis, dtype=np.float64)
    return Rotation.from_rotvec(direction / np.linalg.norm(direction) * angle)

"""What all lights are: a model of the scene file that gives a lamp at every time."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.model import FrozenModel, Vector3
from scenetruth.scene.motion import MotionModel, Points

__all__ = ["EVERYWHERE", "Lamp", "LightModel", "moved_axis"]

EVERYWHERE = -1.0
"""Cosine of the angle of a border that a lamp which shines everywhere does not have."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """One light at one time.

    Parameters
    ----------
    position_mm
        World position, shape (3,); None if it is infinitely far away.
    axis
        Unit vector along which it shines, shape (3,); zeros for a point light.
    irradiance
        E of a surface that faces it, at the reference distance.
    reference_distance_mm
        That distance; 0 for a directional light.
    cos_inner, cos_outer
        Cosines of the angles from the axis where the border of a spot begins and ends; -1 and -1 for others, which
        shine everywhere.
    """

    position_mm: NDArray[np.float64] | None
    axis: NDArray[np.float64]
    irradiance: float
    reference_distance_mm: float
    cos_inner: float
    cos_outer: float


class LightModel(FrozenModel):
    """What all lights share."""

    kind: str
    """Name of the light."""

    @abstractmethod
    def lamp(self, t: float) -> Lamp:
        """Return the light at time t (in frames)."""


def moved_axis(
    motions: tuple[MotionModel, ...], at: Vector3, ahead: Vector3, t: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move a lamp and a point on its axis as one rigid body.

    Parameters
    ----------
    motions
        Its motions; rotations without a point turn about the lamp.
    at, ahead
        The lamp and the point at t = 0, mm.
    t
        Time in frames.

    Returns
    -------
    tuple
        Position, mm, and unit vector along the axis, shape (3,) each; the vector is zero where both points are one.
    """
    position: Any = tuple(float(value) for value in at)
    time = np.array([float(t)])
    both = np.array([at, ahead], dtype=np.float64)
    points: Points = (both[:, 0], both[:, 1], both[:, 2])
    for motion in motions:
        points = motion.point_map(position)(points, time)
    here, there = np.column_stack([np.broadcast_to(field, (2,)) for field in points])
    axis = there - here
    return here, axis / max(float(np.linalg.norm(axis)), 1e-300)

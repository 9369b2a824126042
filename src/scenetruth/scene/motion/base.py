"""What all motions are: a model of the scene file that gives a map of points, which depends on time."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.model import FrozenModel, Vector3
from scenetruth.scene.jets import Field

__all__ = ["MotionModel", "Moved", "PointMap", "Points"]

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


class MotionModel(FrozenModel):
    """What all motions share. A motion is written as one formula for positions; derivatives follow from it."""

    kind: str
    """Name of the motion."""

    @abstractmethod
    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map of the motion in the world.

        Parameters
        ----------
        position_mm
            Position of what moves at t = 0, mm: the point that stays in place if a rotation names none.
        """

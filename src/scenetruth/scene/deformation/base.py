"""What all deformations are: a model of the scene file that gives a map of points in the object's own frame."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from scenetruth.model import FrozenModel
from scenetruth.scene.jets import Field
from scenetruth.scene.motion import PointMap, Points

__all__ = ["DeformationModel", "DeformationStep", "OwnFrameModel", "Surroundings"]


@dataclass(frozen=True)
class Surroundings:
    """What deformations must know of their object and of the scene.

    Parameters
    ----------
    extent_mm
        Least and largest X of the mesh, of a sheet in the flat, mm.
    frame_interval_s
        Time between frames in seconds.
    """

    extent_mm: tuple[float, float]
    frame_interval_s: float

    @property
    def hours_per_frame(self) -> float:
        """Time between frames in hours."""
        return self.frame_interval_s / 3600


class OwnFrameModel(FrozenModel):
    """What may stand in an object's list of deformations: it acts in the own frame, before the object is posed."""

    kind: str
    """Name of the deformation."""


class DeformationModel(OwnFrameModel):
    """What all deformations share. One is written as one formula for positions; derivatives follow from it."""

    in_the_flat: ClassVar[bool] = False
    """Whether it acts on the flat of a sheet (a leaf's blade), before the sheet takes its shape."""

    @abstractmethod
    def point_map(self, around: Surroundings) -> PointMap:
        """Return the map of the deformation in the object's own frame.

        Parameters
        ----------
        around
            What it has to know of its object and of the scene.
        """

    def problem(self, around: Surroundings, points: Points, t: Field) -> tuple[str, str]:
        """Return which field keeps the deformation from being applied to points at a time, and why.

        Parameters
        ----------
        around
            What it has to know of its object and of the scene.
        points
            Coordinates before the deformation, mm: arrays.
        t
            Time in frames, shape (1,).

        Returns
        -------
        tuple
            Name of the field and what is wrong, or two empty strings.
        """
        return "", ""


@dataclass(frozen=True, eq=False)
class DeformationStep:
    """A map that knows which deformation of its object it is.

    Parameters
    ----------
    number
        Its place in the object's list of deformations.
    entry
        The deformation of the scene.
    surroundings
        What it has to know.
    point_map
        The map.
    """

    number: int
    entry: DeformationModel
    surroundings: Surroundings
    point_map: PointMap

    def __call__(self, points: Points, t: Field) -> Points:
        """Move points; see `PointMap`."""
        return self.point_map(points, t)

    def problem(self, points: Points, t: Field) -> tuple[str, str]:
        """Return what keeps it from being applied to points (arrays) at a time; see `DeformationModel.problem`."""
        return self.entry.problem(self.surroundings, points, t)

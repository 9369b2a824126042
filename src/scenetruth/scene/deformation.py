"""Deformations made real: which map each kind of the scene format is, and where it does not hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenetruth.scene import deformation_spec as kinds
from scenetruth.scene.bending import bending_map, bending_problem
from scenetruth.scene.growth import growth_map, growth_problem
from scenetruth.scene.jets import Field
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.maps import turn
from scenetruth.scene.motion.time_curve import value_at
from scenetruth.scene.unrolling import unrolling_map, unrolling_problem

__all__ = ["DeformationStep", "Surroundings", "deformation_map", "deformation_problem"]


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
    entry: kinds.DeformationModel
    surroundings: Surroundings
    point_map: PointMap

    def __call__(self, points: Points, t: Field) -> Points:
        """Move points; see `PointMap`."""
        return self.point_map(points, t)


def deformation_map(entry: kinds.DeformationModel, surroundings: Surroundings) -> PointMap:
    """Return the map of one deformation in an object's own frame."""
    return _MAPS[type(entry)](entry, surroundings)


def deformation_problem(step: DeformationStep, points: Points, t: Field) -> tuple[str, str]:
    """Return which field keeps a deformation from being applied to points (arrays) at a time, and why.

    Returns
    -------
    tuple
        Name of the field and what is wrong, or two empty strings.
    """
    find = _PROBLEMS.get(type(step.entry))
    return ("", "") if find is None else find(step.entry, step.surroundings, points, t)


def _hinge(entry: kinds.Hinge) -> PointMap:
    return lambda points, t: turn(points, entry.axis, np.pi / 180 * value_at(entry.angle_deg, t), entry.point_mm)


def _star(entry: kinds.Star, surroundings: Surroundings) -> PointMap:
    left, right = surroundings.extent_mm
    at_left, at_right = entry.period_mm
    slope = (at_right - at_left) / (right - left) if right > left else 0.0

    def displace(points: Points, t: Field) -> Points:
        x, y, z = points
        return x, y + value_at(entry.amplitude_mm, t) * np.cos(2 * np.pi * y / (at_left + slope * (x - left))), z

    return displace


_MAPS: dict[type, Callable[[Any, Surroundings], PointMap]] = {
    kinds.Hinge: lambda entry, _: _hinge(entry),
    kinds.Growth: lambda entry, around: growth_map(entry, around.hours_per_frame, around.extent_mm),
    kinds.Bending: lambda entry, _: bending_map(entry),
    kinds.Unrolling: lambda entry, _: unrolling_map(entry),
    kinds.Star: _star,
}
_PROBLEMS: dict[type, Callable[[Any, Surroundings, Points, Field], tuple[str, str]]] = {
    kinds.Growth: lambda entry, around, points, t: growth_problem(
        entry, around.hours_per_frame, around.extent_mm, points, t
    ),
    kinds.Bending: lambda entry, _, points, t: bending_problem(entry, points, t),
    kinds.Unrolling: lambda entry, _, points, t: unrolling_problem(entry, points, t),
}

"""The simulations of a sweep: every point, and every seed of it."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scenetruth.dataset.recipe.paths import assign
from scenetruth.scene import Scene, scene_from_plain

__all__ = ["Plan", "Point"]


@dataclass(frozen=True)
class Point:
    """A scene, and the values of all that varies.

    Parameters
    ----------
    scene
        Number of the scene.
    values
        The values, in the order of the factors.
    """

    scene: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Plan:
    """All simulations of a sweep, each made from its number.

    Parameters
    ----------
    labels
        What the scenes are called.
    plains
        The scenes, as plain values.
    factors
        Paths of what varies.
    places
        Paths of the fields, without wildcards, by scene and factor.
    points
        The points.
    seeds
        The seeds of each scene.
    is_grid
        Whether points are all combinations of values, and none fill ranges.
    logarithmic
        Factors that are drawn on a logarithmic scale.
    """

    labels: tuple[str, ...]
    plains: tuple[Mapping[str, Any], ...] = field(repr=False)
    factors: tuple[str, ...]
    places: tuple[tuple[tuple[str, ...], ...], ...] = field(repr=False)
    points: tuple[Point, ...] = field(repr=False)
    seeds: tuple[tuple[int, ...], ...]
    is_grid: bool = True
    logarithmic: frozenset[str] = frozenset()

    def __len__(self) -> int:
        """Return how many simulations there are."""
        return len(self.points) * self.each

    @property
    def each(self) -> int:
        """How many simulations a point has."""
        return len(self.seeds[0])

    def at(self, number: int) -> tuple[Point, int]:
        """Return the point of a simulation, and its seed."""
        place, which = divmod(number, self.each)
        point = self.points[place]
        return point, self.seeds[point.scene][which]

    def is_first(self, number: int) -> bool:
        """Return whether a simulation is the first of its point."""
        return number % self.each == 0

    def scene(self, number: int) -> Scene:
        """Return the scene of a simulation.

        Raises
        ------
        SceneError
            If the values make none.
        """
        point, seed = self.at(number)
        return scene_from_plain({**self.plain(point), "seed": seed})

    def plain(self, point: Point) -> dict[str, Any]:
        """Return the scene of a point as plain values."""
        found = copy.deepcopy(dict(self.plains[point.scene]))
        for places, value in zip(self.places[point.scene], point.values, strict=True):
            for place in places:
                assign(found, place, copy.deepcopy(value))
        return found

    def values(self, point: Point) -> dict[str, Any]:
        """Return the values of a point by what varies."""
        return dict(zip(self.factors, point.values, strict=True))

"""Refuses deformations and motions that cannot be: triangles turned inside out, sheets through themselves, clocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.scene.deformation import DeformationStep
from scenetruth.scene.item import SceneObject
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.motion.presets import FRAME_INTERVAL_S
from scenetruth.scene.spec import Scene
from scenetruth.scene.surface.start import Start

__all__ = ["movement_problems"]

# A triangle whose area falls below this share of what it was has shrunk to nothing; float64 leaves 1e-16.
_LEAST_AREA = 1e-9
# Triangles that stand upright on X and Y have no sign there.
_UPRIGHT = 1e-6


def movement_problems(
    scene: Scene,
    where: str,
    thing: SceneObject,
    start: Start,
    maps: Sequence[PointMap],
    faces: NDArray[np.int32],
    times: Sequence[float],
) -> list[Problem]:
    """Return what is wrong with how an object is deformed and moved.

    Parameters
    ----------
    scene
        The scene.
    where, thing
        The object's path in it, and the object.
    start, maps, faces
        The object's points at rest, how they move, and its faces, shape (m, 3).
    times
        Times to look at, in frames.

    Returns
    -------
    list
        One problem at most for each deformation, at the first time at which there is one.
    """
    found: dict[int, Problem] = {}
    last = max((n for n, item in enumerate(maps) if isinstance(item, DeformationStep)), default=-1)
    for t in times:
        at = np.array([float(t)])
        points = start.at(at)
        for item in maps[: last + 1]:
            if not isinstance(item, DeformationStep):
                points = item(points, at)
                continue
            field, message = item.problem(points, at)
            moved = points if field else item(points, at)
            if not field and not all(np.isfinite(coordinate).all() for coordinate in moved):
                message = "moves points to where no number reaches; make it slower, or smaller"
            elif not field and item.entry.in_the_flat:
                message = _inside_out(points, moved, faces)
            if message:
                path = f"{where}.deformation.{item.number}" + (f".{field}" if field else "")
                found.setdefault(item.number, Problem(path, f"{message} (at t = {t:g})"))
                break
            points = moved
    return [found[number] for number in sorted(found)] + _clock_problems(scene, where, thing)


def _inside_out(before: Points, after: Points, faces: NDArray[np.int32]) -> str:
    """Say how many triangles a map along X and Y inverts or makes vanish, or return nothing."""
    one, other = _areas(before, faces), _areas(after, faces)
    sides = [_extent(np.broadcast_to(field, before[0].shape), faces) for field in before]
    flat = np.abs(one) > _UPRIGHT * np.max(sides, axis=0) ** 2
    bad = flat & ~(other * np.sign(one) > _LEAST_AREA * np.abs(one))
    count = int(np.count_nonzero(bad))
    return f"turns {count} of {len(faces)} triangles inside out, or shrinks them to nothing" if count else ""


def _extent(field: Any, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return by how much a coordinate differs within each face; `numpy.ptp` takes several times as long for three."""
    a, b, c = (field[faces[:, corner]] for corner in range(3))
    extent: NDArray[np.float64] = np.maximum(np.maximum(a, b), c) - np.minimum(np.minimum(a, b), c)
    return extent


def _areas(points: Points, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return twice the signed areas along X and Y."""
    x, y = (np.asarray(field)[faces] for field in points[:2])
    areas: NDArray[np.float64] = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    return areas


def _clock_problems(scene: Scene, where: str, item: SceneObject) -> list[Problem]:
    """Return which presets, made for one frame a minute, are used at another interval."""
    interval: Any = scene.frames.frame_interval_s
    if interval == FRAME_INTERVAL_S:
        return []
    message = (
        f"is a rate at one frame a minute, but frames.frame_interval_s is {interval:g}: make that 60, or give a rate"
    )
    return [
        Problem(f"{where}.motion.{number}.preset", message, preset)
        for number, motion in enumerate(item.motion)
        if (preset := getattr(motion, "preset", None)) is not None
    ]

"""Whether the light on a scene makes sense: no light inside an object, and brightness that stays positive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.scene.light.base import EVERYWHERE
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World

__all__ = ["lighting_problems"]

# A direction in which no mesh is likely to have edges or faces.
_UNSTEADY = 1e-3
_ODD_WAY = np.array([0.351938, 0.681273, 0.641873])


def lighting_problems(scene: Scene, world: World, times: Sequence[float] | None = None) -> list[Problem]:
    """Return what is wrong with a scene's lighting: lights inside objects, and brightness that does not stay positive.

    All frames, or the given times in frames, are looked at. Only closed meshes have an inside: those in which every
    edge belongs to an even number of triangles. A light is inside if a ray from it passes the surface an odd number of
    times.
    """
    lighting = scene.lighting
    times = [float(t) for t in scene.frames.t] if times is None else times
    problems = []
    brightness = [lighting.brightness(t) for t in times]
    if min(brightness) <= 0:
        worst = times[int(np.argmin(brightness))]
        message = (
            f"makes the brightness {min(brightness):.6g} at frame {worst:g}; it must stay positive over all frames"
        )
        problems.append(Problem("lighting.drift_per_frame", message, lighting.drift_per_frame))
    problems += _lost_lamps(scene, times)
    if problems or all(lamp.position_mm is None for lamp in lighting.lamps_at(0.0)):
        return problems
    closed = [_is_closed(body.positions_at(0.0), body.faces) for body in world.bodies]
    found: set[tuple[int, int]] = set()
    for t in times:
        places = [body.positions_at(t) if shut else None for body, shut in zip(world.bodies, closed, strict=True)]
        for number, lamp in enumerate(lighting.lamps_at(t)):
            if lamp.position_mm is None:
                continue
            for index, body in enumerate(world.bodies):
                corners = places[index]
                if corners is None or (number, index) in found:
                    continue
                if _is_inside(lamp.position_mm, corners, body.faces):
                    found.add((number, index))
                    message = f"the light is inside '{body.name}' at frame {t:g}; move it out"
                    where = tuple(round(float(value), 6) for value in lamp.position_mm)
                    problems.append(Problem(f"lighting.lights.{number}.position_mm", message, where))
    return problems


def _lost_lamps(scene: Scene, times: Sequence[float]) -> list[Problem]:
    """Return which lamps are moved so far that they, or the directions in which they shine, are no numbers any more."""
    lost: dict[int, Problem] = {}
    for t in times:
        for number, lamp in enumerate(scene.lighting.lamps_at(t)):
            directed = lamp.position_mm is None or lamp.cos_outer > EVERYWHERE
            shines = not directed or abs(float(np.linalg.norm(lamp.axis)) - 1) < _UNSTEADY
            if not shines or not (lamp.position_mm is None or np.isfinite(lamp.position_mm).all()):
                message = f"moves the light, at frame {t:g}, so far that its place or direction is lost; make it slower"
                lost.setdefault(number, Problem(f"lighting.lights.{number}.motion", message))
    return list(lost.values())


def _is_closed(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    _, welded = np.unique(vertices, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[faces]
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    return bool((uses % 2 == 0).all())


def _is_inside(point: NDArray[np.float64], vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    if (point < vertices.min(axis=0)).any() or (point > vertices.max(axis=0)).any():
        return False
    first, second, third = (vertices[faces[:, k]] - point for k in range(3))
    # Signed volumes of the ray and each edge, exactly opposite for the two faces that share it: none slips through.
    volumes = np.stack([np.cross(a, b) @ _ODD_WAY for a, b in ((first, second), (second, third), (third, first))])
    normals = np.cross(second - first, third - first)
    slope = normals @ _ODD_WAY
    ahead = np.einsum("ij,ij->i", normals, first) * slope > 0
    crossed = ((volumes >= 0).all(axis=0) | (volumes < 0).all(axis=0)) & (slope != 0) & ahead
    return bool(np.count_nonzero(crossed) % 2)

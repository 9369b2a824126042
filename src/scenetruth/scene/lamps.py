"""Lights made real: where they are and where they shine at any time, and whether they stand inside an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.scene.lighting_spec import Light, Lighting
from scenetruth.scene.motion import compose
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World

__all__ = ["Lamp", "lamps_at", "lighting_problems"]

# A direction in which no mesh is likely to have edges or faces.
_ODD_WAY = np.array([0.351938, 0.681273, 0.641873])


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


def lamps_at(lighting: Lighting, t: float) -> list[Lamp]:
    """Return the lights at time t (in frames), in the scene's order."""
    return [_lamp(light, t) for light in lighting.lights]


def _lamp(light: Light, t: float) -> Lamp:
    if light.kind == "directional":
        at, ahead = np.zeros(3), np.asarray(light.direction)
    elif light.kind == "point":
        at, ahead = np.asarray(light.position_mm), np.asarray(light.position_mm)
    else:
        at = np.asarray(light.position_mm)
        ahead = at + np.asarray(light.direction) if light.target_mm is None else np.asarray(light.target_mm)
    position = (float(at[0]), float(at[1]), float(at[2]))
    motions = [motion.point_map(position) for motion in light.motion]
    at, ahead = compose(motions, np.stack([at, ahead]), t).positions_mm
    axis = ahead - at
    axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
    if light.kind == "directional":
        return Lamp(None, axis, light.irradiance, 0.0, -1.0, -1.0)
    if light.kind == "point":
        return Lamp(at, np.zeros(3), light.irradiance, light.reference_distance_mm, -1.0, -1.0)
    inner, outer = np.cos(np.deg2rad([light.inner_angle_deg, light.outer_angle_deg]))
    return Lamp(at, axis, light.irradiance, light.reference_distance_mm, float(inner), float(outer))


def lighting_problems(scene: Scene, world: World) -> list[Problem]:
    """Return what is wrong with a scene's lighting: lights inside objects, and brightness that does not stay positive.

    All frames are looked at. Only closed meshes have an inside: those in which every edge belongs to an even number of
    triangles. A light is inside if a ray from it passes the surface an odd number of times.
    """
    lighting, times = scene.lighting, [float(t) for t in scene.frames.t]
    problems = []
    brightness = [lighting.brightness(t) for t in times]
    if min(brightness) <= 0:
        worst = times[int(np.argmin(brightness))]
        message = (
            f"makes the brightness {min(brightness):.6g} at frame {worst:g}; it must stay positive over all frames"
        )
        problems.append(Problem("lighting.drift_per_frame", message, lighting.drift_per_frame))
    if all(light.kind == "directional" for light in lighting.lights):
        return problems
    closed = [_is_closed(body.vertices_mm, body.faces) for body in world.bodies]
    found: set[tuple[int, int]] = set()
    for t in times:
        vertices, offsets = world.at(t).vertices_mm, world.vertex_offsets
        for number, lamp in enumerate(lamps_at(lighting, t)):
            if lamp.position_mm is None:
                continue
            for index, body in enumerate(world.bodies):
                if not closed[index] or (number, index) in found:
                    continue
                corners = vertices[offsets[index] : offsets[index + 1]]
                if _is_inside(lamp.position_mm, corners, body.faces):
                    found.add((number, index))
                    message = f"the light is inside '{body.name}' at frame {t:g}; move it out"
                    where = tuple(round(float(value), 6) for value in lamp.position_mm)
                    problems.append(Problem(f"lighting.lights.{number}.position_mm", message, where))
    return problems


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

"""A scene made real: meshes, texture coordinates and motions, ready to be seen at any time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene.mesh import make_mesh
from scenetruth.scene.motion import PointMotion, compose, motions_of, pose_points
from scenetruth.scene.spec import Scene
from scenetruth.scene.texture import SurfaceTexture, make_texture

__all__ = ["Body", "Snapshot", "World", "build_world", "generator_for"]


@dataclass(frozen=True, eq=False)
class Body:
    """One object of the world.

    Parameters
    ----------
    name
        Its name in the scene.
    vertices_mm
        World positions at t = 0, shape (n, 3).
    faces
        Vertex indices, shape (m, 3).
    uv
        Texture coordinates at the corners, shape (m, 3, 2).
    texture
        What is painted on it.
    motions
        How it moves.
    """

    name: str
    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float64]
    texture: SurfaceTexture
    motions: Sequence[PointMotion]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """All vertices of the world at one time.

    Parameters
    ----------
    t
        Time in frames.
    vertices_mm
        World positions, shape (n, 3), float64.
    velocities
        Their velocities in mm per frame, shape (n, 3), float64.
    """

    t: float
    vertices_mm: NDArray[np.float64]
    velocities: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class World:
    """All objects of a scene, as one list of vertices and one of faces."""

    bodies: tuple[Body, ...]

    @cached_property
    def vertex_offsets(self) -> NDArray[np.int64]:
        """First vertex of every body in the common list, and the total count."""
        return np.cumsum([0, *(len(body.vertices_mm) for body in self.bodies)])

    @cached_property
    def face_offsets(self) -> NDArray[np.int64]:
        """First face of every body in the common list, and the total count."""
        return np.cumsum([0, *(len(body.faces) for body in self.bodies)])

    @cached_property
    def faces(self) -> NDArray[np.int32]:
        """Vertex indices of all faces in the common list, shape (m, 3)."""
        parts = [body.faces + offset for body, offset in zip(self.bodies, self.vertex_offsets, strict=False)]
        return np.concatenate(parts).astype(np.int32)

    @cached_property
    def uv(self) -> NDArray[np.float64]:
        """Texture coordinates at the corners of all faces, shape (m, 3, 2)."""
        return np.concatenate([body.uv for body in self.bodies])

    @cached_property
    def face_body(self) -> NDArray[np.int32]:
        """Index of the body that every face belongs to, shape (m,)."""
        return np.repeat(np.arange(len(self.bodies), dtype=np.int32), np.diff(self.face_offsets))

    def at(self, t: float) -> Snapshot:
        """Return all vertices and their velocities at time t (in frames)."""
        moved = [compose(body.motions, body.vertices_mm, t) for body in self.bodies]
        return Snapshot(t, np.concatenate([points for points, _ in moved]), np.concatenate([v for _, v in moved]))


def generator_for(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return a random generator of its own for one purpose: independent of every other, and of any order of calls.

    Parameters
    ----------
    seed
        The scene's seed.
    purpose
        What the numbers serve: ``("texture", name)``, ``("sensor", s, t)``.
    """
    key = "/".join(map(str, purpose)).encode()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def build_world(scene: Scene, folder: Path = Path()) -> World:
    """Make meshes, textures and motions of a scene.

    Parameters
    ----------
    scene
        The scene.
    folder
        Where relative paths in it count from.

    Raises
    ------
    SceneError
        With every mesh and texture that cannot be made.
    """
    bodies: list[Body] = []
    problems: list[Problem] = []
    for index, item in enumerate(scene.objects):
        part = "mesh"
        try:
            mesh = make_mesh(item.mesh, folder)
            part = "texture"
            texture, uv = make_texture(item.texture, mesh, folder, generator_for(scene.seed, "texture", item.name))
        except SceneError as error:
            problems += [
                Problem(f"objects.{index}.{part}.{problem.path}", problem.message, problem.value)
                for problem in error.problems
            ]
            continue
        vertices = pose_points(item.pose, mesh.vertices_mm)
        bodies.append(Body(item.name, vertices, mesh.faces, uv, texture, motions_of(item)))
    if problems:
        raise SceneError(problems)
    return World(tuple(bodies))

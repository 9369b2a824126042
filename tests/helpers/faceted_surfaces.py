"""Surfaces of many small facets that tests share."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh import TriangleMesh
from tests.helpers.scenes import cube

SMOOTH_DEG = 60.0


def waves(generator: np.random.Generator, points: NDArray[np.float64], count: int = 5) -> NDArray[np.float64]:
    """Return a random smooth function of points (n, k) with slopes of about 1 per unit."""
    k = points.shape[1]
    return np.asarray(
        sum(
            np.sin(points @ generator.uniform(-3, 3, k) + generator.uniform(0, 6)) * generator.uniform(0.1, 0.3)
            for _ in range(count)
        )
    )


def relief(seed: int, cells: int, size_mm: float = 60.0, height: float = 0.15) -> TriangleMesh:
    """Return a sheet like a wavy leaf, as `mesh.plane` with smooth heights; ``height`` counts in half sizes."""
    generator = np.random.default_rng(seed)
    steps = np.linspace(-1, 1, cells + 1)
    flat = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([flat, height * waves(generator, flat)]) * size_mm / 2
    index = np.arange(len(flat)).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=1).reshape(-1, 3)
    corners = flat[faces]
    return TriangleMesh(
        vertices, faces.astype(np.int32), corners * size_mm / 2, (corners + 1) / 2, crease_deg=SMOOTH_DEG
    )


def ball(seed: int, subdivisions: int, radius_mm: float = 25.0) -> TriangleMesh:
    """Return a ball with bumps."""
    generator = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(subdivisions)
    faces = np.asarray(sphere.faces, dtype=np.int32)
    vertices = np.asarray(sphere.vertices)
    vertices = vertices * (1 + 0.08 * waves(generator, 1.5 * vertices)[:, None]) * radius_mm
    corners = vertices[faces][..., :2]
    return TriangleMesh(vertices, faces, corners, corners / (2.5 * radius_mm) + 0.5, crease_deg=SMOOTH_DEG)


def scene_of(*items: dict[str, Any], **changes: Any) -> Scene:
    """Return a scene of objects, whose meshes are given afterwards: poses and textures may be named, or are made up."""
    plain: dict[str, Any] = {
        "mesh": {"kind": "plane", "size_mm": [1, 1]},
        "pose": {"position_mm": [0, 0, 660]},
        "texture": {"kind": "noise", "wavelength_mm": [2.0, 9.0]},
    }
    objects = [plain | {"name": f"object {n}"} | item for n, item in enumerate(items)]
    return cube(**({"objects": objects} | changes))


def world_of(scene: Scene, *meshes: TriangleMesh) -> BuiltScene:
    """Build the world of a scene with other meshes than it says, one for each object."""
    return build_scene(scene, meshes=dict(zip([item.name for item in scene.objects], meshes, strict=True)))

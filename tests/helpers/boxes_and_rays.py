"""Boxes, rays, and the intersections of all triangles as a reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.scene.mesh import make_box

__all__ = ["Array", "boxes", "brute_force", "grid"]


Array = NDArray[np.float64]


def brute_force(vertices: Array, faces: NDArray[np.int32], origin: Array, directions: Array) -> tuple[Array, Array]:
    """Möller and Trumbore for every ray and triangle; depth of the first hit, and how near any edge is."""
    a, b, c = (vertices[faces[:, k]][None] for k in range(3))
    d = directions[:, None]
    p = np.cross(d, c - a)
    det = np.einsum("...i,...i", b - a, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("...i,...i", origin - a, p) / det
        q = np.cross(origin - a, b - a)
        v = np.einsum("...i,...i", d, q) / det
        depth = np.einsum("...i,...i", c - a, q) / det
    inner = np.minimum(np.minimum(u, v), 1 - u - v)
    depth = np.where((inner >= 0) & (depth > 0), depth, np.inf)
    doubt = np.abs(inner).min(axis=1)
    return depth.min(axis=1), doubt


def grid(width: int, height: int, focal: float) -> Array:
    y, x = np.mgrid[:height, :width].astype(np.float64)
    flat = np.stack([(x - (width - 1) / 2) / focal, (y - (height - 1) / 2) / focal, np.ones_like(x)], axis=-1)
    return flat.reshape(-1, 3)


def boxes(generator: np.random.Generator, count: int, distance: float) -> tuple[Array, NDArray[np.int32]]:
    vertices, faces = [], []
    for n in range(count):
        mesh = make_box(tuple(generator.uniform(5, 60, 3)))
        turned = Rotation.random(None, generator).apply(mesh.vertices_mm)
        vertices.append(turned + [*generator.uniform(-40, 40, 2), distance])
        faces.append(mesh.faces + 8 * n)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)

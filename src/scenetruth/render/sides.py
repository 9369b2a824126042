"""Texture coordinates on the side of a surface that is seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.world import World

__all__ = ["seen_uv"]


def seen_uv(world: World, vertices_mm: NDArray[np.float64], origin_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the texture coordinates at the corners of all faces, on the side that is seen from a point.

    The front of a face is the side to which its normal (p1 - p0) x (p2 - p0) points: seen from there, its corners run
    counter-clockwise.

    Parameters
    ----------
    world
        The scene's objects.
    vertices_mm
        World positions of the vertices, shape (n, 3).
    origin_mm
        Position of the camera, shape (3,).

    Returns
    -------
    numpy.ndarray
        Shape (m, 3, 2): `World.uv` of faces seen from the front, `World.uv_back` of those seen from the back.
    """
    if world.uv_back is world.uv:
        return world.uv
    from scenetruth.raycast.edge_kernels import face_sides

    _normals, front = face_sides(vertices_mm, world.faces, np.asarray(origin_mm, dtype=np.float64))
    return np.where(front[:, None, None], world.uv, world.uv_back)

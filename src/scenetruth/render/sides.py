"""Which side of a surface is seen, and the texture coordinates on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.world import World

__all__ = ["seen_uv"]


def seen_uv(world: World, vertices_mm: NDArray[np.float64], origin_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the texture coordinates at the corners of all faces as somebody sees them.

    A face is seen from behind by whoever stands on the side from which its corners run clockwise, away from which
    (p1 - p0) x (p2 - p0) points.

    Parameters
    ----------
    world
        The scene's objects.
    vertices_mm
        Where their vertices are, shape (n, 3).
    origin_mm
        Where the eye is, shape (3,).

    Returns
    -------
    numpy.ndarray
        Shape (m, 3, 2): `World.uv` of faces seen from before, `World.uv_back` of those seen from behind.
    """
    if world.uv_back is world.uv:
        return world.uv
    from scenetruth.raycast.edge_kernels import face_sides

    _normals, front = face_sides(vertices_mm, world.faces, np.asarray(origin_mm, dtype=np.float64))
    return np.where(front[:, None, None], world.uv, world.uv_back)

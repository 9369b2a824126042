"""Which edges of a mesh are edges of the object, by the normals that came with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.grid import CREASE_DEG
from scenetruth.scene.mesh.sides import places_of, shared_sides

__all__ = ["creases_by_normals"]

# Normals that differ by less are the same one, written down with few digits.
_SAME_DEG = 1.0


def creases_by_normals(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], corner_normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the crease angle of every side of every triangle; see `TriangleMesh.crease_deg`.

    Where two triangles meet with the same normals at both ends of their edge, the surface is smooth there, unless they
    differ by more than any facets of a smooth surface; with others, the edge is sharp. Where a normal is missing, the
    angle between the triangles decides.

    Parameters
    ----------
    vertices
        Positions, shape (n, 3).
    faces
        Vertex indices, shape (m, 3).
    corner_normals
        Unit normals at the corners, of either sense, shape (m, 3, 3); NaN where there is none.

    Returns
    -------
    numpy.ndarray
        Angles in degrees, shape (m, 3): `CREASE_DEG`, or 0 for sharp edges.
    """
    one, two, flipped = shared_sides(places_of(vertices)[faces])
    next_one, next_two = (side - side % 3 + (side + 1) % 3 for side in (one, two))
    normals = corner_normals.reshape(-1, 3)
    sharp = np.zeros(len(one), dtype=np.bool_)
    for first, second in ((one, np.where(flipped, two, next_two)), (next_one, np.where(flipped, next_two, two))):
        cosine = np.abs(np.einsum("ij,ij->i", normals[first], normals[second]))
        # A comparison with NaN is false.
        sharp |= cosine < np.cos(np.deg2rad(_SAME_DEG))
    creases = np.full(faces.size, CREASE_DEG)
    creases[one[sharp]] = creases[two[sharp]] = 0.0
    return creases.reshape(-1, 3)

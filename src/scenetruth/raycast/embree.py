"""A mesh in Embree, which guesses in float32 which face a ray meets first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["EmbreeMesh"]

# Rays are handed to Embree in pieces, so that its copies of them stay small.
_PIECE = 1 << 20


class EmbreeMesh:
    """A mesh at one time in Embree.

    Parameters
    ----------
    vertices_mm
        World positions, shape (n, 3).
    faces
        Vertex indices, shape (m, 3).
    """

    def __init__(self, vertices_mm: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # float32 is most precise around zero: the mesh is moved there, and the rays with it.
        self._centre = (vertices_mm.min(axis=0) + vertices_mm.max(axis=0)) / 2
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, (vertices_mm - self._centre).astype(np.float32), faces)

    def first_faces(self, starts_mm: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.int32]:
        """Guess the first face that each ray meets.

        Parameters
        ----------
        starts_mm
            Where the rays start, shape (n, 3), or (3,) if all start there.
        directions
            Directions of the rays, of any length, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            Index of the face, -1 for none, shape (n,). Near edges it may be wrong, by the rounding of float32.
        """
        starts = np.broadcast_to(starts_mm, directions.shape)
        faces = np.empty(len(directions), dtype=np.int32)
        for first in range(0, len(directions), _PIECE):
            piece = slice(first, first + _PIECE)
            faces[piece] = self._scene.run(
                (starts[piece] - self._centre).astype(np.float32), directions[piece].astype(np.float32)
            )
        return faces

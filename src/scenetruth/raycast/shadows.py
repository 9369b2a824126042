"""Shadows: which points of a mesh a light does not reach, decided in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.embree import EmbreeMesh
from scenetruth.raycast.topology import Topology

__all__ = ["ShadowCaster"]

# Faces that are nearer to the point than this share of the ray's length do not shade it: rounding in float64.
_TOUCH = 1e-9


class ShadowCaster:
    """A mesh at one time, which casts shadows on its own surface.

    Parameters
    ----------
    vertices_mm
        World positions, shape (n, 3), float64.
    topology
        The mesh's faces and edges.
    """

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        self.vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
        self.topology = topology
        # Rays are no longer than the mesh is wide: from far lights, they would be less precise.
        self._longest = 1.01 * float(np.linalg.norm(self.vertices_mm.max(axis=0) - self.vertices_mm.min(axis=0)))
        self._embree = EmbreeMesh(self.vertices_mm, topology.faces)

    def blocked(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        to_light: NDArray[np.float64],
        distance_mm: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Tell which points a light does not reach.

        Rays run from the light to the points; from a far light, they start just outside the mesh. A point is in shadow
        if its ray meets any face but the point's own before it. No offset from the surface is needed.

        Parameters
        ----------
        points_mm
            Points on the mesh, shape (n, 3).
        faces
            The face that each lies on, shape (n,).
        to_light
            Unit vectors towards the light, shape (n, 3).
        distance_mm
            Distance of the light, shape (n,), infinite for parallel light.

        Returns
        -------
        numpy.ndarray
            bool, shape (n,).
        """
        from scenetruth.raycast.shadow_kernels import confirm_blocked

        reach = np.minimum(distance_mm, self._longest)
        ways = to_light * -reach[:, None]
        starts = points_mm - ways
        guesses = self._embree.first_faces(starts, ways)
        shaded: NDArray[np.bool_] = confirm_blocked(
            self.vertices_mm,
            self.topology.faces,
            self.topology.face_neighbours,
            starts,
            ways,
            guesses,
            faces,
            1 - _TOUCH,
        )
        return shaded

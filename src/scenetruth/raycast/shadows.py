"""Whether anything stands between points of a mesh and a light: Embree guesses in float32, float64 decides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.topology import Topology

__all__ = ["ShadowCaster"]

# What is nearer to the point than this share of the ray's length does not shade it: roundings in float64.
_TOUCH = 1e-9
# Rays are handed to Embree in pieces, so that its copies of them stay small.
_PIECE = 1 << 20


class ShadowCaster:
    """A mesh at one time, ready for rays from lights to its own surface.

    Parameters
    ----------
    vertices_mm
        World positions, shape (n, 3), float64.
    topology
        The mesh's faces and edges.
    """

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
        self.topology = topology
        # float32 is most precise around zero: the mesh is moved there, and the rays with it.
        low, high = self.vertices_mm.min(axis=0), self.vertices_mm.max(axis=0)
        self._centre = (low + high) / 2
        # No longer than what can be in the way: lights far off would take precision from the rays.
        self._longest = 1.01 * float(np.linalg.norm(high - low))
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, (self.vertices_mm - self._centre).astype(np.float32), topology.faces)

    def blocked(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        to_light: NDArray[np.float64],
        distance_mm: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return which points a light does not reach.

        Rays start at the light, or where they enter the mesh's surroundings. Whatever they meet before the point takes
        the light away, but for the point's own face: no offset from the surface is needed.

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
        result = np.empty(len(points_mm), dtype=np.bool_)
        for first in range(0, len(points_mm), _PIECE):
            piece = slice(first, first + _PIECE)
            guesses = self._scene.run(
                (starts[piece] - self._centre).astype(np.float32), ways[piece].astype(np.float32)
            ).astype(np.int32)
            result[piece] = confirm_blocked(
                self.vertices_mm,
                self.topology.faces,
                self.topology.face_neighbours,
                starts[piece],
                ways[piece],
                guesses,
                faces[piece],
                1 - _TOUCH,
            )
        return result

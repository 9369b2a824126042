"""Shadows: points of a mesh that a light does not reach, decided in float64."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.mesh_topology import Topology
from scenetruth.raycast.ray_caster import EmbreeMesh

__all__ = ["ShadowCaster"]

_TOUCH = 1e-9  # faces closer to the point than this fraction of the ray length cast no shadow (float64 rounding)
_ROUNDINGS = 16  # error of Embree's float32 hits in units of the rounding of the coordinates
_CELLS_PER_FACE, _MOST_CELLS = 2, 1 << 22  # number of cells for parallel light per face, and in total


class ShadowCaster:
    """Shadow computation for a mesh at one time that casts shadows on itself; world positions in mm."""

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        self.vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
        self.topology = topology
        self._centre = (self.vertices_mm.min(axis=0) + self.vertices_mm.max(axis=0)) / 2
        # Rays are limited to the mesh diagonal, because longer rays are less precise.
        self._longest = 1.01 * float(np.linalg.norm(self.vertices_mm.max(axis=0) - self.vertices_mm.min(axis=0)))
        self._in_light: dict[bytes, Any] = {}

    @cached_property
    def _embree(self) -> EmbreeMesh:
        return EmbreeMesh(self.vertices_mm, self.topology.faces)

    def blocked_parallel(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        wanted: NDArray[np.bool_],
        to_light: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return which wanted points parallel light does not reach; bit-identical to `blocked`, but faster."""
        from scenetruth.raycast.shadow_kernels import BLOCKED, UNSURE, parallel_shadows

        state = parallel_shadows(
            self.vertices_mm,
            self.topology.faces,
            self.topology.face_neighbours,
            self._faces_in_light(to_light),
            np.ascontiguousarray(points_mm),
            faces,
            wanted,
            to_light,
            self._longest,
            1 - _TOUCH,
        )
        shaded: NDArray[np.bool_] = state == BLOCKED
        # Cases that depend on float32 rounding are resolved by Embree for identical results.
        unsure = np.flatnonzero(state == UNSURE)
        if len(unsure):
            many = np.broadcast_to(to_light, (len(unsure), 3))
            shaded[unsure] = self.blocked(points_mm[unsure], faces[unsure], many, np.full(len(unsure), np.inf))
        return shaded

    def _faces_in_light(self, to_light: NDArray[np.float64]) -> Any:
        """Return the faces in light coordinates, cached for the lights of this time."""
        from scenetruth.raycast.shadow_kernels import FacesInLight, flatten_faces, sort_faces

        key = to_light.tobytes()
        if key not in self._in_light:
            along = -to_light / np.linalg.norm(to_light)
            across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
            across /= np.linalg.norm(across)
            frame = np.stack([across, np.cross(along, across), along])
            size = float(np.abs(self.vertices_mm - self._centre).max()) + self._longest
            tolerance = _ROUNDINGS * float(np.finfo(np.float32).eps) * size
            numbers, boxes = flatten_faces(self.vertices_mm, self.topology.faces, frame, tolerance)
            # All points lie on the mesh, so the cells cover its extent.
            across_light = self.vertices_mm @ frame[:2].T
            low = across_light.min(axis=0) - tolerance
            extent = across_light.max(axis=0) + tolerance - low
            cells = min(_CELLS_PER_FACE * len(boxes), _MOST_CELLS)
            edge = max(float(np.sqrt(extent[0] * extent[1] / cells)), float(extent.max()) / cells)
            columns, rows = (int(length / edge) + 1 for length in extent.tolist())
            starts, listed, large = sort_faces(numbers, boxes, low, 1 / edge, columns, rows, tolerance)
            self._in_light[key] = FacesInLight(
                frame, numbers, low, 1 / edge, columns, rows, starts, listed, large, tolerance
            )
        return self._in_light[key]

    def blocked(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        to_light: NDArray[np.float64],
        distance_mm: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return which points a light does not reach.

        Rays run from the light (for distant lights, from just outside the mesh) to the points. A point is in shadow if
        its ray first hits a face other than its own; no offset from the surface is needed.

        ``to_light``: Unit vectors towards the light, shape (n, 3).
        ``distance_mm``: Distance of the light, shape (n,), infinite for parallel light.
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

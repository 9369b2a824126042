"""Casting rays at a mesh: float64 decides, after Embree's guess or for every triangle near a ray of a grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.topology import Topology

if TYPE_CHECKING:
    from embreex.rtcore_scene import EmbreeScene

__all__ = ["Hits", "RayCaster"]

# Embree's rays and triangles are float32: a few roundings of the coordinates' size at the hit.
_MARGIN_ROUNDINGS = 16
# Rays are handed to Embree in pieces, so that its copies of them stay small.
_PIECE = 1 << 20
# Faces up to which holding each against the grid is faster than asking Embree (measured: equal at about 1e5).
_MOST_RASTERED = 100_000


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet first.

    Parameters
    ----------
    face
        Index of the face, shape (n,), int32; -1 for none.
    depth
        Ray parameter of the point: its depth Z for directions with Z = 1. NaN for none.
    weights
        Barycentric coordinates of the face's second and third corner, shape (n, 2).
    """

    face: NDArray[np.int32]
    depth: NDArray[np.float64]
    weights: NDArray[np.float64]

    def interpolate(self, faces: NDArray[np.int32], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate values given at vertices; shape (n, ...), NaN where nothing is hit."""
        return self._mix(values[faces[self.face, 0]], values[faces[self.face, 1]], values[faces[self.face, 2]])

    def interpolate_corners(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate values given at the corners of faces, shape (m, 3, ...)."""
        return self._mix(values[self.face, 0], values[self.face, 1], values[self.face, 2])

    def _mix(
        self, first: NDArray[np.float64], second: NDArray[np.float64], third: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        # first + b1 (second - first) + ...: a value that all corners share comes out unchanged.
        b1, b2 = self.weights[:, :1], self.weights[:, 1:]
        mixed: NDArray[np.float64] = first + b1 * (second - first) + b2 * (third - first)
        mixed[self.face < 0] = np.nan
        return mixed


class RayCaster:
    """A mesh at one time, ready for rays.

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
        # float32 is most precise around zero: the mesh is moved there, and the rays with it.
        self._centre = (self.vertices_mm.min(axis=0) + self.vertices_mm.max(axis=0)) / 2
        self._extent = float(np.abs(self.vertices_mm - self._centre).max())

    def cast(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int = 0) -> Hits:
        """Find what rays from one point meet first.

        Parameters
        ----------
        origin_mm
            Where all rays start, shape (3,).
        directions
            Their directions, shape (n, 3), of any length; the depth of a hit counts in these lengths.
        grid_width
            If the rays form a grid, row by row, its width: every face is then held against every ray near it, or the
            neighbours in the grid help to decide rays that pass an edge within float32 precision. Either is exact.

        Returns
        -------
        Hits
            The first face met by every ray, from either side.
        """
        origin = np.asarray(origin_mm, dtype=np.float64)
        directions = np.ascontiguousarray(directions, dtype=np.float64)
        if grid_width > 0 and len(self.topology.faces) <= _MOST_RASTERED:
            hits = self._raster(origin, directions, grid_width)
            if hits is not None:
                return hits
        return self._trace(origin, directions, grid_width)

    def _raster(self, origin: NDArray[np.float64], directions: NDArray[np.float64], width: int) -> Hits | None:
        """Hold faces against a grid of rays; None if the rays do not all point into one half space."""
        from scenetruth.raycast.raster_kernels import prepare_faces, raster_hits, tile_bounds

        frame = _frame_of(directions)
        bounds, forward = tile_bounds(directions, width, frame)
        if not forward:
            return None
        forms, boxes = prepare_faces(self.vertices_mm, self.topology.faces, origin, frame)
        return Hits(*raster_hits(forms, boxes, frame, bounds, directions, width))

    def _trace(self, origin: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int) -> Hits:
        """Let Embree guess a face for every ray, and float64 decide."""
        from scenetruth.raycast.kernels import refine_hits

        start = (origin - self._centre).astype(np.float32)
        guesses = np.empty(len(directions), dtype=np.int32)
        for first in range(0, len(directions), _PIECE):
            piece = directions[first : first + _PIECE].astype(np.float32)
            guesses[first : first + _PIECE] = self._embree.run(
                np.ascontiguousarray(np.broadcast_to(start, piece.shape)), piece
            )
        reach = np.linalg.norm(self._centre - origin)
        nearest = max(float(reach) - self._extent, 1e-2 * float(reach), 1e-9)
        margin = _MARGIN_ROUNDINGS * float(np.finfo(np.float32).eps) * (1 + self._extent / nearest)
        face, depth, weights = refine_hits(
            self.vertices_mm,
            self.topology.faces,
            self.topology.face_neighbours,
            origin,
            directions,
            guesses,
            grid_width,
            margin,
        )
        return Hits(face, depth, weights)

    @cached_property
    def _embree(self) -> EmbreeScene:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(scene, (self.vertices_mm - self._centre).astype(np.float32), self.topology.faces)
        return scene


def _frame_of(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two directions across, and an axis along which rays point, as the rows of a rotation."""
    few = directions[:: max(1, len(directions) // 1024)]
    few = few[np.isfinite(few).all(axis=1)]
    axis = (few / np.maximum(np.linalg.norm(few, axis=1, keepdims=True), 1e-300)).sum(axis=0)
    length = np.linalg.norm(axis)
    if length == 0:
        return np.eye(3)
    axis /= length
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(axis, across), axis])

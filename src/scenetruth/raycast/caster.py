"""Casting rays at a mesh: float64 decides, for every triangle near a ray or after Embree's guess."""

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
# Faces up to which each is held against the rays near it: at 1e6 seven times as fast as asking Embree (measured), but
# 136 bytes a face.
_MOST_RASTERED = 2_000_000
# Faces up to which a grid of rays is searched tile by tile; beyond, faces are small and cells of a few rays are better.
_MOST_TILED = 2_000
# A ray's cell holds about so many rays, and cells list no more faces than this, all together.
_RAYS_PER_CELL = 4
_MOST_LISTED = 1 << 26


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
        # Origin, frame, forms and boxes of `prepare_faces`.
        self._prepared: (
            tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None
        ) = None

    def cast(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int = 0) -> Hits:
        """Find what rays from one point meet first.

        Parameters
        ----------
        origin_mm
            Where all rays start, shape (3,).
        directions
            Their directions, shape (n, 3), of any length; the depth of a hit counts in these lengths.
        grid_width
            If the rays form a grid, row by row, its width: few faces are then held against it tile by tile, and should
            Embree be asked, neighbours in the grid help to decide rays that pass an edge within float32 precision.

        Returns
        -------
        Hits
            The first face met by every ray, from either side.
        """
        origin = np.asarray(origin_mm, dtype=np.float64)
        directions = np.ascontiguousarray(directions, dtype=np.float64)
        if len(directions) and len(self.topology.faces) <= _MOST_RASTERED:
            tiled = grid_width > 0 and len(self.topology.faces) <= _MOST_TILED
            hits = self._raster(origin, directions, grid_width) if tiled else self._scatter(origin, directions)
            if hits is not None:
                return hits
        return self._trace(origin, directions, grid_width)

    def _raster(self, origin: NDArray[np.float64], directions: NDArray[np.float64], width: int) -> Hits | None:
        """Hold faces against tiles of a grid of rays; None if the rays do not all point into one half space."""
        from scenetruth.raycast.raster_kernels import raster_hits, tile_bounds

        frame = _frame_of(directions)
        bounds, forward = tile_bounds(directions, width, frame)
        if not forward:
            return None
        forms, boxes = self._prepared_for(origin, frame)
        return Hits(*raster_hits(forms, boxes, frame, bounds, directions, width))

    def _scatter(self, origin: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits | None:
        """Hold faces against the rays in the cells that they touch; None as of `_raster`, or if they touch too many."""
        from scenetruth.raycast.scatter_kernels import bin_faces, scatter_hits, sort_rays

        side = 1 << max(0, round(np.log2(max(1, len(directions) // _RAYS_PER_CELL)) / 2))
        # Rays that come after others from the same point use what was prepared for those.
        frames = [] if self._prepared is None else [self._prepared[1]]
        for frame in (*frames, _frame_of(directions)):
            order, cell_start, field, forward = sort_rays(directions, frame, side)
            if forward:
                break
        else:
            return None
        forms, boxes = self._prepared_for(origin, frame)
        listed, row_start = bin_faces(boxes, field, side, _MOST_LISTED)
        if row_start[-1] > len(listed):
            return None
        return Hits(*scatter_hits(forms, boxes, field, side, directions, order, cell_start, listed, row_start))

    def _prepared_for(
        self, origin: NDArray[np.float64], frame: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what `prepare_faces` finds, kept until rays start elsewhere."""
        from scenetruth.raycast.raster_kernels import prepare_faces

        if self._prepared is None or not ((self._prepared[0] == origin).all() and (self._prepared[1] == frame).all()):
            prepared = prepare_faces(self.vertices_mm, self.topology.faces, origin, frame)
            self._prepared = (origin.copy(), frame, *prepared)
        return self._prepared[2:]

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

"""Ray casting: first hits decided in float64, by faces, tiles or bins, or from float32 candidates of Embree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.mesh_topology import Topology

if TYPE_CHECKING:
    from scenetruth.raycast.pixel_ray_kernels import RayGrid

__all__ = ["EmbreeMesh", "Hits", "RayCaster"]


_PIECE = 1 << 20  # rays are passed to Embree in blocks to limit the memory of its copies


class EmbreeMesh:
    """Embree acceleration structure of a mesh at one time."""

    def __init__(self, vertices_mm: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # Mesh and rays are centred at the origin, where float32 is most precise.
        self._centre = (vertices_mm.min(axis=0) + vertices_mm.max(axis=0)) / 2
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, (vertices_mm - self._centre).astype(np.float32), faces)

    def first_faces(self, starts_mm: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the candidate first face of rays, -1 for none; possibly wrong near edges due to float32."""
        starts = np.broadcast_to(starts_mm, directions.shape)
        faces = np.empty(len(directions), dtype=np.int32)
        for first in range(0, len(directions), _PIECE):
            piece = slice(first, first + _PIECE)
            faces[piece] = self._scene.run(
                (starts[piece] - self._centre).astype(np.float32), directions[piece].astype(np.float32)
            )
        return faces


_MARGIN_ROUNDINGS = 16  # error of Embree's float32 hits in units of the rounding of the coordinates
# Up to this number of faces, each face is tested against nearby rays: measured seven times as fast as Embree for 1e6
# faces, but it needs 136 bytes per face.
_MOST_RASTERED = 2_000_000
# Up to this number of faces, other ray grids are searched by tiles; for more faces, cells of few rays are faster.
_MOST_TILED = 2_000
# Ray grids are searched face by face if their axes are perpendicular within this cosine, and the boxes of all faces
# together cover every ray at most this often on average.
_RECTANGULAR, _MOST_LAYERS = 1e-9, 100
# Mean number of rays per cell, and maximum number of entries in the face lists of all cells.
_RAYS_PER_CELL = 4
_MOST_LISTED = 1 << 26


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits: face, -1 for none; ray parameter, NaN for none; weights of the second and third corner."""

    face: NDArray[np.int32]
    depth: NDArray[np.float64]
    weights: NDArray[np.float64]

    def interpolate(self, faces: NDArray[np.int32], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate vertex values, shape (k, ...), of faces, shape (m, 3)."""
        from scenetruth.raycast.hit_kernels import mix_vertices

        flat = np.ascontiguousarray(values, dtype=np.float64).reshape(len(values), -1)
        mixed: NDArray[np.float64] = mix_vertices(self.face, self.weights, faces, flat)
        return mixed.reshape(len(self.face), *values.shape[1:])

    def interpolate_corners(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate values given at the face corners, shape (m, 3, ...)."""
        # Equivalent to a mesh whose faces share no vertices.
        own = np.arange(3 * len(values), dtype=np.int32).reshape(-1, 3)
        return self.interpolate(own, values.reshape(3 * len(values), *values.shape[2:]))


class _Prepared(NamedTuple):
    """Result of `prepare_faces` with its ray origin and projection."""

    origin: NDArray[np.float64]
    frame: NDArray[np.float64]
    forms: NDArray[np.float64]
    boxes: NDArray[np.float64]


class RayCaster:
    """Ray caster for a mesh at one time, with world positions in mm."""

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        self.vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
        self.topology = topology
        # Several times as fast along rows of their own.
        rows = np.ascontiguousarray(self.vertices_mm.T)
        lowest, highest = rows.min(axis=1), rows.max(axis=1)
        self._centre = (lowest + highest) / 2
        self._extent = float(np.maximum(highest - self._centre, self._centre - lowest).max())
        self._prepared: _Prepared | None = None
        self._sides: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]] | None = None
        self._grid: RayGrid | None = None

    @cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """Unit normals of the faces along (p1 - p0) x (p2 - p0), shape (m, 3)."""
        # Coordinate by coordinate: five times as fast as with vectors.
        x, y, z = np.ascontiguousarray(self.vertices_mm.T)
        i, j, k = np.ascontiguousarray(self.topology.faces.T)
        ax, ay, az = x[i], y[i], z[i]
        ux, uy, uz, vx, vy, vz = x[j] - ax, y[j] - ay, z[j] - az, x[k] - ax, y[k] - ay, z[k] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        # Faces of zero area are never hit.
        lengths = np.maximum(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
        normals = np.empty((len(i), 3))
        for axis, component in enumerate((nx, ny, nz)):
            np.divide(component, lengths, out=normals[:, axis])
        return normals

    def sides(self, origin_mm: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the normals of the faces and whether each has its front towards a point, see `face_sides`."""
        from scenetruth.raycast.edge_kernels import face_sides

        origin, known = np.asarray(origin_mm, dtype=np.float64), self._sides
        if known is None or not (known[0] == origin).all():
            known = self._sides = (origin.copy(), *face_sides(self.vertices_mm, self.topology.faces, origin))
        return known[1:]

    def cast(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int = 0) -> Hits:
        """Compute the first hit of rays from one point; the unit of the hit depth is the length of each direction."""
        origin = np.asarray(origin_mm, dtype=np.float64)
        directions = np.ascontiguousarray(directions, dtype=np.float64)
        if len(directions) and len(self.topology.faces) <= _MOST_RASTERED:
            if 1 < grid_width < len(directions):
                hits = self._cover(origin, directions, grid_width)
                if hits is not None:
                    return hits
            tiled = grid_width > 0 and len(self.topology.faces) <= _MOST_TILED
            hits = self._raster(origin, directions, grid_width) if tiled else self._scatter(origin, directions)
            if hits is not None:
                return hits
        return self._trace(origin, directions, grid_width)

    def hit_faces(
        self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], face: NDArray[np.int32]
    ) -> Hits:
        """Return the hits of rays whose first faces are determined, as `cast` returns them."""
        from scenetruth.raycast.raster_kernels import hits_on_faces

        origin, directions = np.asarray(origin_mm, dtype=np.float64), np.ascontiguousarray(directions)
        return Hits(face, *hits_on_faces(self.vertices_mm, self.topology.faces, origin, directions, face))

    def cast_in_pixels(
        self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], pixels: NDArray[np.int64]
    ) -> Hits:
        """Compute the first hit of rays from one point anywhere in pixels of the last grid cast from there.

        ``pixels``: Pixel of each ray in row-major order, ascending, shape (n,). Rays of other grids are cast as by
          `cast`.
        """
        grid, origin = self._grid, np.asarray(origin_mm, dtype=np.float64)
        if grid is None or not (grid.origin == origin).all() or not len(directions):
            return self.cast(origin, directions)
        from scenetruth.raycast.pixel_ray_kernels import pixel_hits

        return Hits(*pixel_hits(grid, *self._prepared_for(origin, grid.frame), directions, pixels))

    def _raster(self, origin: NDArray[np.float64], directions: NDArray[np.float64], width: int) -> Hits | None:
        """Compute hits of a ray grid tile by tile; None if the rays do not all point into one half space."""
        from scenetruth.raycast.raster_kernels import raster_hits, tile_bounds

        frame = _compute_frame(directions)
        bounds, forward = tile_bounds(directions, width, frame)
        if not forward:
            return None
        forms, boxes = self._prepared_for(origin, frame)
        return Hits(*raster_hits(forms, boxes, frame, bounds, directions, width))

    def _cover(self, origin: NDArray[np.float64], directions: NDArray[np.float64], width: int) -> Hits | None:
        """Compute hits of a regular ray grid face by face; None for other grids, or if faces cover too many rays."""
        from scenetruth.raycast.pixel_ray_kernels import RayGrid
        from scenetruth.raycast.raster_kernels import count_covered, grid_hits, grid_steps

        self._grid = None
        across, down = directions[width - 1] - directions[0], directions[-width] - directions[0]
        size = float(np.linalg.norm(across) * np.linalg.norm(down))
        if not abs(across @ down) < _RECTANGULAR * size:
            return None
        across /= np.linalg.norm(across)
        axis = np.cross(across, down / np.linalg.norm(down))
        axis /= np.linalg.norm(axis)
        frame = np.stack([across, np.cross(axis, across), axis])
        grid, regular = grid_steps(directions, width, frame)
        if not regular:
            return None
        forms, boxes = self._prepared_for(origin, frame)
        height = len(directions) // width
        if count_covered(boxes, grid, width, height) > _MOST_LAYERS * len(directions):
            return None
        self._grid = RayGrid(self.vertices_mm, self.topology.faces, origin.copy(), frame, grid, width, height)
        return Hits(*grid_hits(forms, boxes, grid, directions, width))

    def _scatter(self, origin: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits | None:
        """Compute hits of sorted rays cell by cell; None as in `_raster`, or if faces touch too many cells."""
        from scenetruth.raycast.binned_ray_kernels import bin_faces, scatter_hits, sort_rays

        side = 1 << max(0, round(np.log2(max(1, len(directions) // _RAYS_PER_CELL)) / 2))
        # For an unchanged origin the previous projection is tried first, because its faces are prepared.
        frames = [] if self._prepared is None else [self._prepared.frame]
        for frame in (*frames, _compute_frame(directions)):
            order, cell_start, field, forward = sort_rays(directions, frame, side)
            if forward:
                break
        else:
            return None
        forms, boxes = self._prepared_for(origin, frame)
        listed, row_start = bin_faces(boxes, field, side, _MOST_LISTED)
        if row_start[-1] > len(listed):
            return None
        return Hits(*scatter_hits(forms, boxes, frame, field, side, directions, order, cell_start, listed, row_start))

    def _prepared_for(
        self, origin: NDArray[np.float64], frame: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the forms and boxes of `prepare_faces`, cached for the current origin."""
        from scenetruth.raycast.raster_kernels import prepare_faces

        known = self._prepared
        if known is None or not ((known.origin == origin).all() and (known.frame == frame).all()):
            prepared = prepare_faces(self.vertices_mm, self.topology.faces, origin, frame)
            known = self._prepared = _Prepared(origin.copy(), frame, *prepared)
        return known.forms, known.boxes

    def _trace(self, origin: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int) -> Hits:
        """Compute hits from candidate faces of Embree, refined in float64."""
        from scenetruth.raycast.hit_kernels import refine_hits

        guesses = self._embree.first_faces(origin, directions)
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
    def _embree(self) -> EmbreeMesh:
        return EmbreeMesh(self.vertices_mm, self.topology.faces)


def _compute_frame(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the projection frame of rays: two transverse unit vectors and the mean direction (rows of a rotation)."""
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

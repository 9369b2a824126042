"""Shadows: points of a mesh that a light does not reach, decided in float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.mesh_topology import Topology
from scenetruth.raycast.ray_caster import EmbreeMesh

__all__ = ["FaceShadows", "ShadowCaster"]

_TOUCH = 1e-9  # faces closer to the point than this fraction of the ray length cast no shadow (float64 rounding)
_ROUNDINGS = 16  # error of Embree's float32 hits in units of the rounding of the coordinates
_CELLS_PER_FACE, _MOST_CELLS = 2, 1 << 22  # number of cells for parallel light per face, and in total
_APART = 1e-9  # distance, as a fraction of the mesh diagonal, below which faces touch

_ASIDE = 1e-6  # distance from the border of a shadow at which it is tested, as a fraction of the mesh diagonal


@dataclass(frozen=True, eq=False)
class FaceShadows:
    """Shadow of a mesh on its own faces under parallel light.

    ``state``: State of each face, shape (m,), uint8: `LIT` or `BLOCKED` everywhere, or `UNSURE` if the border of a
      shadow may cross it. The light is taken to shine on the face.
    ``starts_mm``, ``ends_mm``: Ends of straight lines on the faces that contain all these borders, shape (k, 3) each.
    ``face``: Face of each line, shape (k,).
    ``meeting``: Faces that intersect others, shape (m,).
    """

    state: NDArray[np.uint8]
    starts_mm: NDArray[np.float64]
    ends_mm: NDArray[np.float64]
    face: NDArray[np.int32]
    meeting: NDArray[np.bool_]


class ShadowCaster:
    """Shadow computation for a mesh at one time that casts shadows on itself; world positions in mm."""

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        self.vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
        self.topology = topology
        # Several times as fast along rows of their own.
        rows = np.ascontiguousarray(self.vertices_mm.T)
        lowest, highest = rows.min(axis=1), rows.max(axis=1)
        self._centre = (lowest + highest) / 2
        # Rays are limited to the mesh diagonal, because longer rays are less precise.
        self._longest = 1.01 * float(np.linalg.norm(highest - lowest))
        self._in_light: dict[bytes, Any] = {}
        self._on_faces: dict[bytes, FaceShadows] = {}
        # The cameras of a time, which several threads render, have these in common.
        self._alone = RLock()

    @cached_property
    def _embree(self) -> EmbreeMesh:
        return EmbreeMesh(self.vertices_mm, self.topology.faces)

    def blocked_parallel(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        wanted: NDArray[np.bool_],
        to_light: NDArray[np.float64],
        *,
        confirmed: bool = True,
    ) -> NDArray[np.bool_]:
        """Return which wanted points parallel light does not reach; bit-identical to `blocked`, but faster.

        ``confirmed``: Whether hits in float64 count only if the float32 candidates of Embree agree, as in `blocked`.
        """
        from scenetruth.raycast.shadow_kernels import BLOCKED, LIT, UNSURE, parallel_shadows

        state = parallel_shadows(
            self.vertices_mm,
            self.topology.faces,
            self.topology.face_neighbours[: None if confirmed else 0],
            self._faces_in_light(to_light),
            np.ascontiguousarray(points_mm),
            faces,
            wanted,
            to_light,
            self._longest,
            1 - _TOUCH,
        )
        if not confirmed:
            return np.asarray(state != LIT)
        shaded: NDArray[np.bool_] = state == BLOCKED
        # Cases that depend on float32 rounding are resolved by Embree for identical results.
        unsure = np.flatnonzero(state == UNSURE)
        if len(unsure):
            many = np.broadcast_to(to_light, (len(unsure), 3))
            shaded[unsure] = self.blocked(points_mm[unsure], faces[unsure], many, np.full(len(unsure), np.inf))
        return shaded

    def groups_above(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        wanted: NDArray[np.bool_],
        to_light: NDArray[np.float64],
        groups: NDArray[np.uint8],
        *,
        on_faces: bool,
    ) -> NDArray[np.uint64]:
        """Return the groups of the faces that shade wanted points from parallel light, one bit each from the lowest.

        ``groups``: Group of each face, below 64, shape (m,).
        ``on_faces``: Whether the points are on flat faces, of which those outside all shadows need not be searched.
        """
        from scenetruth.raycast.shadow_kernels import LIT, groups_above

        if on_faces:
            wanted = wanted & (self.on_faces(to_light).state != LIT)[faces]
        points, light = np.ascontiguousarray(points_mm), self._faces_in_light(to_light)
        found: NDArray[np.uint64] = groups_above(light, points, faces, wanted, groups, self._longest * _TOUCH)
        return found

    def on_faces(self, to_light: NDArray[np.float64]) -> FaceShadows:
        """Return the shadows of parallel light on all faces, cached for the lights of this time.

        Within a face, a shadow begins or ends only under the contour of the mesh, seen from the lamp, and where another
        face intersects it. Faces without such a line are entirely in the light or in shadow, as their centre is.
        """
        key = to_light.tobytes()
        with self._alone:
            if key not in self._on_faces:
                self._on_faces[key] = self._find_shadows(to_light)
            return self._on_faces[key]

    def _find_shadows(self, to_light: NDArray[np.float64]) -> FaceShadows:
        from scenetruth.raycast.shadow_border_kernels import cast_edges, cross_faces, measure_faces
        from scenetruth.raycast.shadow_kernels import PLANE, STEEP, UNSURE

        light, topology, apart = self._faces_in_light(to_light), self.topology, _APART * self._longest
        places, count = self.vertices_mm @ light.frame.T, len(topology.faces)
        centres, boxes, front = measure_faces(self.vertices_mm, places, topology.faces)
        contour = self._contour(front)
        ends, edge_faces = places[topology.edges[contour]], topology.edge_faces[contour]
        under, spans = _found(
            lambda pairs, spans: cast_edges(ends, edge_faces, light, apart, pairs, spans), 8 * len(ends) + 64, (2,)
        )
        # A long edge meets a face in several cells.
        _, first = np.unique(under[:, 0] * count + under[:, 1], return_index=True)
        under, spans = under[first], spans[first]
        start, step = ends[under[:, 0], 0][:, None], (ends[under[:, 0], 1] - ends[under[:, 0], 0])[:, None]
        lines = start + spans[:, :, None] * step
        numbers = light.numbers[under[:, 1], None, PLANE : PLANE + 3]
        lines[..., 2] = (numbers[..., :2] * lines[..., :2]).sum(axis=-1) + numbers[..., 2]
        meeting, common = _found(
            lambda pairs, lines: cross_faces(places, topology.faces, boxes, light, apart, pairs, lines), 4096, (2, 3)
        )
        _, first = np.unique(meeting[:, 0] * count + meeting[:, 1], return_index=True)
        meeting, common = meeting[first], common[first]
        lines = np.concatenate([lines, common, common]) @ light.frame
        face = np.concatenate([under[:, 1], meeting[:, 0], meeting[:, 1]]).astype(np.int32)
        joined = np.zeros(count, dtype=np.bool_)
        joined[meeting] = True
        unsure = ~np.isfinite(light.numbers[:, STEEP])
        unsure[face] = True
        every = np.arange(count, dtype=np.int32)
        state = self.blocked_parallel(centres, every, ~unsure, to_light, confirmed=False).astype(np.uint8)
        state[unsure] = UNSURE
        return FaceShadows(state, lines[:, 0], lines[:, 1], face, joined)

    def changes_across(
        self,
        points_mm: NDArray[np.float64],
        along: NDArray[np.float64],
        faces: NDArray[np.int32],
        normals: NDArray[np.float64],
        to_light: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return whether a shadow begins at points on lines.

        ``along``: Directions of the lines, shape (n, 3).
        ``faces``, ``normals``: Faces of the points with their unit normals.
        """
        across = np.cross(normals, along)
        across *= _ASIDE * self._longest / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        every = np.ones(len(faces), dtype=np.bool_)
        one, other = (
            self.blocked_parallel(points_mm + sign * across, faces, every, to_light, confirmed=False)
            for sign in (-1, 1)
        )
        return np.asarray(one != other)

    def _contour(self, front: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the edges of the contour seen along the light, from the sides of the faces, see `measure_faces`."""
        topology = self.topology
        pair = topology.edge_faces
        turned = (front[pair[:, 0]] != front[pair[:, 1]]) != topology.edge_flipped
        return np.flatnonzero(turned | topology.edge_crowded | (pair[:, 1] < 0))

    def _faces_in_light(self, to_light: NDArray[np.float64]) -> Any:
        """Return the faces in light coordinates, cached for the lights of this time."""
        key = to_light.tobytes()
        with self._alone:
            if key not in self._in_light:
                self._in_light[key] = self._flatten(to_light)
            return self._in_light[key]

    def _flatten(self, to_light: NDArray[np.float64]) -> Any:
        """Return the faces in light coordinates."""
        from scenetruth.raycast.shadow_kernels import FacesInLight, flatten_faces, sort_faces

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
        return FacesInLight(frame, numbers, low, 1 / edge, columns, rows, starts, listed, large, tolerance)

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


def _found(
    search: Callable[[NDArray[np.int64], NDArray[np.float64]], int], space: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the pairs and values that a kernel finds, with as much space as it needs."""
    while True:
        pairs, values = np.empty((space, 2), dtype=np.int64), np.empty((space, *shape))
        used = search(pairs, values)
        if used <= space:
            return pairs[:used], values[:used]
        space = used

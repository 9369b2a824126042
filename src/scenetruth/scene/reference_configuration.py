"""Reference configuration of a body before any motion, with surface derivatives by formula or quadric fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.mesh_model import TriangleMesh, find_shared_sides, index_positions
from scenetruth.scene.motion import PointMap, Points, apply
from scenetruth.scene.taylor import AA, AB, ACROSS, ALONG, BB, TA, TB, TT, VALUE, A, B, Jet, JetField, T

__all__ = [
    "AnalyticConfiguration",
    "FittedConfiguration",
    "QuadricFit",
    "ReferenceConfiguration",
    "SheetConfiguration",
    "corner_normals",
    "fit_quadrics",
    "make_reference_configuration",
    "make_surface_jet",
]


Floats = NDArray[np.float64]

# Minimum eigenvalue ratio of the normal equations of a fit (coordinates scaled by the neighbour distance).
_LEAST_RATIO = 1e-6


@dataclass(frozen=True, eq=False)
class QuadricFit:
    """Surface points of a mesh and linear operators for derivatives along the surface.

    A surface point is a vertex restricted to one smooth piece of the surface: a vertex on a sharp edge has one for each
    side. Its coordinates a and b refer to two orthonormal tangents.

    ``corners``: Surface point at every face corner, shape (m, 3), int32.
    ``vertices``: Vertex of each surface point, shape (k,).
    ``starts``, ``neighbours``: Neighbours of surface point i: vertices ``neighbours[starts[i] : starts[i + 1]]``.
    ``coefficients``: Weights of the difference to each neighbour in the derivatives (a, b, aa, ab, bb), shape
      (len(neighbours), 5).
    """

    corners: NDArray[np.int32]
    vertices: NDArray[np.int64]
    starts: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    coefficients: Floats

    def derivatives(self, field: Floats) -> Floats:
        """Return the derivatives (a, b, aa, ab, bb), shape (5, k), of a vertex field of shape (n,)."""
        owner = np.repeat(np.arange(len(self.vertices)), np.diff(self.starts))
        difference = field[self.neighbours] - field[self.vertices][owner]
        count = len(self.vertices)
        return np.stack([np.bincount(owner, difference * column, count) for column in self.coefficients.T])


def fit_quadrics(vertices_mm: Floats, faces: NDArray[np.int32], crease_deg: float | Floats) -> QuadricFit:
    """Fit a quadratic function of two tangent coordinates around every vertex.

    Gradients are accurate to second order in the edge length, second derivatives to first order (second on regular
    meshes). Second derivatives not determined by the neighbours, as at the corners of a box, are zero.
    """
    corners, vertex_of = _surface_points(vertices_mm, faces, crease_deg)
    count = len(vertex_of)
    normals = np.zeros((count, 3))
    face_normals = np.cross(
        vertices_mm[faces[:, 1]] - vertices_mm[faces[:, 0]], vertices_mm[faces[:, 2]] - vertices_mm[faces[:, 0]]
    )
    for corner in range(3):
        np.add.at(normals, corners[:, corner], face_normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    one = np.cross(axis, normals)
    one /= np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-300)
    frames = np.stack([one, np.cross(normals, one)], axis=1)

    rows, columns = (
        np.concatenate([corners[:, i] for i in order]) for order in ((0, 1, 2, 1, 2, 0), (1, 2, 0, 0, 1, 2))
    )
    sides = np.sort(rows.astype(np.int64) * count + columns)
    owner, ring = np.divmod(sides[np.diff(sides, prepend=-1) > 0], count)
    all_points = np.arange(count)
    fits = _fit(vertices_mm, vertex_of, frames, all_points, owner, ring)
    poor = np.flatnonzero(~fits[3])
    if len(poor):
        again = _fit(vertices_mm, vertex_of, frames, poor, *_neighbours_of_neighbours(owner, ring, poor, count))
        lengths, nearest, values, _ = fits
        keep = np.repeat(fits[3], lengths)
        owner = np.concatenate([np.repeat(all_points, lengths)[keep], np.repeat(poor, again[0])])
        order = np.argsort(owner, kind="stable")
        neighbours = np.concatenate([nearest[keep], again[1]])[order]
        coefficients = np.concatenate([values[keep], again[2]])[order]
        counts = np.bincount(owner, minlength=count)
    else:
        counts, neighbours, coefficients = fits[:3]
    starts = np.concatenate([[0], np.cumsum(counts)])
    return QuadricFit(corners, vertex_of, starts, neighbours, coefficients)


def _surface_points(
    vertices: Floats, faces: NDArray[np.int32], crease_deg: float | Floats
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the surface point at every face corner, and the vertex of each."""
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    one, two, flipped = find_shared_sides(index_positions(vertices)[faces])
    cosine = np.einsum("ij,ij->i", normals[one // 3], normals[two // 3]) * np.where(flipped, -1, 1)
    creases = np.broadcast_to(crease_deg, faces.shape).reshape(-1)
    crease = np.minimum(creases[one], creases[two])
    smooth = (cosine >= np.cos(np.deg2rad(crease))) & (crease > 0)
    one, two, flipped = one[smooth], two[smooth], flipped[smooth]
    next_one, next_two = (index - index % 3 + (index + 1) % 3 for index in (one, two))
    # Adjacent faces traverse a shared edge in opposite directions: the first corner of one is the second of the other.
    ends = (np.where(flipped, two, next_two), np.where(flipped, next_two, two))
    rows, columns = np.concatenate([one, next_one]), np.concatenate(ends)
    count = faces.size
    first = _connected(rows, columns, count)
    alone = first == np.arange(count)
    label = (np.cumsum(alone) - 1)[first]
    vertex_of = np.empty(np.count_nonzero(alone), dtype=np.int64)
    vertex_of[label] = faces.ravel()
    return label.reshape(faces.shape).astype(np.int32), vertex_of


def _connected(one: NDArray[np.integer[Any]], two: NDArray[np.integer[Any]], count: int) -> NDArray[np.integer[Any]]:
    """Return the first node of the component of each node, for edges between nodes ``one`` and ``two``."""
    first = np.arange(count)
    while True:
        least = np.minimum(first[one], first[two])
        nearer = first.copy()
        for ends in (one, two):
            # The node reached so far is moved as well, which shortens chains.
            np.minimum.at(nearer, ends, least)
            np.minimum.at(nearer, first[ends], least)
        nearer = nearer[nearer]
        if (nearer == first).all():
            return first
        first = nearer


def _neighbours_of_neighbours(
    owner: NDArray[np.int64], ring: NDArray[np.int64], points: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the neighbours of the neighbours of points, with the index of the point of each.

    They include the neighbours, with which a point shares triangles.
    """
    lengths = np.bincount(owner, minlength=count)
    starts = np.cumsum(lengths) - lengths
    near, which = _rows(ring, starts, lengths, points)
    far, step = _rows(ring, starts, lengths, near)
    key = which[step] * count + far
    # In the order in which they are met, on which the rounding errors of sums depend.
    order = np.argsort(key, kind="stable")
    place = np.sort(order[np.diff(key[order], prepend=-1) > 0])
    found: tuple[NDArray[np.int64], NDArray[np.int64]] = np.divmod(key[place], count)
    return found


def _rows(
    values: NDArray[np.int64], starts: NDArray[np.int64], lengths: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the values of rows, one after the other, and the index of the row of each."""
    row = np.repeat(np.arange(len(rows)), lengths[rows])
    before = np.cumsum(lengths[rows]) - lengths[rows]
    return values[starts[rows][row] + np.arange(len(row)) - before[row]], row


def _fit(
    vertices: Floats,
    vertex_of: NDArray[np.int64],
    frames: Floats,
    points: NDArray[np.int64],
    owner: NDArray[np.int64],
    other: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Fit around surface points; return neighbour counts, neighbours, coefficients, and whether all are determined.

    ``owner``, ``other``: Index of a point, in increasing order, and a surface point near it.
    """
    keep = points[owner] != other
    owner, other = owner[keep], other[keep]
    count = len(points)
    lengths = np.bincount(owner, minlength=count)
    relative = vertices[vertex_of[other]] - vertices[vertex_of[points]][owner]
    a, b = np.einsum("nij,nj->in", frames[points][owner], relative)
    square = np.bincount(owner, a * a + b * b, count) / np.maximum(lengths, 1)
    scale = np.sqrt(np.maximum(square, 1e-300))
    a, b = a / scale[owner], b / scale[owner]
    design = np.stack([a, b, a * a / 2, a * b, b * b / 2])
    normal = np.empty((count, 5, 5))
    for i in range(5):
        for j in range(5):
            normal[:, i, j] = np.bincount(owner, design[i] * design[j], count)
    values = np.linalg.eigvalsh(normal)
    determined = values[:, 0] > _LEAST_RATIO * np.maximum(values[:, -1], 1e-300)
    inverse = np.zeros_like(normal)
    inverse[determined] = np.linalg.inv(normal[determined])
    inverse[~determined, :2, :2] = np.linalg.pinv(normal[~determined, :2, :2], rcond=_LEAST_RATIO, hermitian=True)
    coefficients = np.einsum("nij,jn->ni", inverse[owner], design)
    coefficients[:, :2] /= scale[owner, None]
    coefficients[:, 2:] /= scale[owner, None] ** 2
    return lengths, vertex_of[other], coefficients, determined


class ReferenceConfiguration(Protocol):
    """Initial points of a body, the input of its chain of maps."""

    @property
    def corners(self) -> NDArray[np.int32]:
        """Surface point at every face corner, shape (m, 3)."""
        ...

    def at(self, t: JetField) -> Points:
        """Return the coordinates of all vertices at times t, as fields of the same type as t."""
        ...

    def surface(self, t: Jet) -> Points:
        """Return the coordinates of all surface points as jets in t, a and b."""
        ...


@dataclass(frozen=True, eq=False)
class SheetConfiguration:
    """Flat sheet with material coordinates a, b in mm equal to X and Y, and Z = 0."""

    material_mm: NDArray[np.float64]
    faces: NDArray[np.int32]

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices are surface points."""
        return self.faces

    def at(self, t: JetField) -> Points:
        """Return the flat sheet."""
        a, b = self.material_mm.T
        return make_constant_field(a, t), make_constant_field(b, t), make_constant_field(np.zeros_like(a), t)

    def surface(self, t: Jet) -> Points:
        """Return the flat sheet with its derivatives."""
        a, b = np.ascontiguousarray(self.material_mm.T)
        return Jet.variable(a, ALONG, 3), Jet.variable(b, ACROSS, 3), Jet.constant(np.zeros_like(a), 3)


@dataclass(frozen=True, eq=False)
class MeshAtRest:
    """Mesh with vertices fixed in the object frame, in mm."""

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]

    def at(self, t: JetField) -> Points:
        """Return the mesh."""
        x, y, z = self.vertices_mm.T
        return make_constant_field(x, t), make_constant_field(y, t), make_constant_field(z, t)


@dataclass(frozen=True, eq=False)
class FittedConfiguration(MeshAtRest):
    """Mesh at rest with derivatives from quadric fits; for ``crease_deg`` see `TriangleMesh`."""

    crease_deg: float | NDArray[np.float64]

    @cached_property
    def osculation(self) -> QuadricFit:
        """Derivative operators along the surface."""
        return fit_quadrics(self.vertices_mm, self.faces, self.crease_deg)

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices on sharp edges have several surface points."""
        return self.osculation.corners

    def surface(self, t: Jet) -> Points:
        """Return the mesh with fitted derivatives."""
        fields = [make_surface_jet(self.osculation, column[None]) for column in self.vertices_mm.T]
        return fields[0], fields[1], fields[2]


@dataclass(frozen=True, eq=False)
class AnalyticConfiguration(MeshAtRest):
    """Mesh at rest on a smooth surface given by a formula; for ``along`` see `TriangleMesh`."""

    along: NDArray[np.float64]

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices are surface points."""
        return self.faces

    def surface(self, t: Jet) -> Points:
        """Return the mesh with its derivatives."""
        coefficients = np.zeros((3, 10, len(self.vertices_mm)))
        coefficients[:, VALUE] = self.vertices_mm.T
        coefficients[:, [A, B, AA, AB, BB]] = np.moveaxis(self.along, 2, 0)
        x, y, z = map(Jet, coefficients)
        return x, y, z


def make_reference_configuration(mesh: TriangleMesh) -> ReferenceConfiguration:
    """Return the reference configuration of a mesh with the most accurate derivatives available."""
    if mesh.material_mm is not None:
        return SheetConfiguration(mesh.material_mm, mesh.faces)
    if mesh.along is not None:
        return AnalyticConfiguration(mesh.vertices_mm, mesh.faces, mesh.along)
    return FittedConfiguration(mesh.vertices_mm, mesh.faces, mesh.crease_deg)


def make_constant_field(values: NDArray[np.float64], t: JetField) -> Any:
    """Return constant values as a field of the same type as t."""
    if isinstance(t, Jet):
        return Jet.constant(np.ascontiguousarray(values, dtype=t.coefficients.dtype), t.variables)
    return np.asarray(values, dtype=t.dtype)


def make_surface_jet(osculation: QuadricFit, orders: NDArray[np.float64]) -> Jet:
    """Return a vertex field, with up to two time derivatives, as a jet in t, a and b at the surface points."""
    coefficients = np.zeros((10, len(osculation.vertices)))
    coefficients[VALUE] = orders[0][osculation.vertices]
    coefficients[[A, B, AA, AB, BB]] = osculation.derivatives(orders[0])
    if len(orders) > 1:
        coefficients[T] = orders[1][osculation.vertices]
        coefficients[[TA, TB]] = osculation.derivatives(orders[1])[:2]
    if len(orders) > 2:
        coefficients[TT] = orders[2][osculation.vertices]
    return Jet(coefficients)


def corner_normals(mesh: TriangleMesh, start: ReferenceConfiguration, maps: Sequence[PointMap], t: float) -> Floats:
    """Return the unit normals of the smooth surface at face corners, (m, 3, 3), sign arbitrary, at t (in frames).

    They are computed from the surface derivatives (NaN if parallel), with an error quadratic in the triangle size.
    Supplied normals rotate with the surface and keep their deviation from the derivative normals at rest.
    """
    moved = _frames(start, maps, t)[start.corners]
    if mesh.corner_normals is None:
        return moved[:, :, 2]
    rest_start = start if isinstance(start, FittedConfiguration) else make_reference_configuration(mesh)
    rest = _frames(rest_start, (), t)[rest_start.corners]
    turned: Floats = np.einsum("mcij,mcik,mck->mcj", moved, rest, mesh.corner_normals)
    return np.where(np.isfinite(turned).all(axis=2, keepdims=True), turned, moved[:, :, 2])


def _frames(start: ReferenceConfiguration, maps: Sequence[PointMap], t: float) -> Floats:
    """Return right-handed frames (along a, across, normal) of all surface points, as rows, shape (k, 3, 3)."""
    time = Jet.variable(np.array([float(t)]), 0, 3)
    points = start.surface(time)
    shape = points[0].coefficients.shape
    fields = [np.broadcast_to(field.coefficients, shape) for field in apply(maps, points, time)]
    one, two = (np.stack([field[slot] for field in fields], axis=1) for slot in (A, B))
    normal = np.cross(one, two)
    with np.errstate(divide="ignore", invalid="ignore"):
        one = one / np.linalg.norm(one, axis=1, keepdims=True)
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([one, np.cross(normal, one), normal], axis=1)

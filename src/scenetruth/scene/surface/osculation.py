"""Derivatives along the surface of a mesh that has no formula: quadratic fits to the neighbours of every vertex."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.sides import places_of, shared_sides

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Osculation", "osculate"]

Floats = NDArray[np.float64]

# Least ratio of the eigenvalues of a fit's normal equations (in units of the neighbours' distance).
_LEAST_RATIO = 1e-6


@dataclass(frozen=True, eq=False)
class Osculation:
    """The surface points of a mesh, and how fields on its vertices change along the surface.

    A surface point is a vertex as seen from one smooth piece of the surface: a vertex on a sharp edge has one for each
    side. Every one has two orthonormal tangents, the directions of its coordinates a and b.

    Parameters
    ----------
    corners
        The surface point at every corner of every face, shape (m, 3), int32.
    vertices
        The vertex that each surface point is, shape (k,).
    starts, neighbours
        Neighbours of surface point i: vertices ``neighbours[starts[i] : starts[i + 1]]``.
    coefficients
        What the difference to each neighbour counts in the derivatives (a, b, aa, ab, bb), shape (len(neighbours), 5).
    """

    corners: NDArray[np.int32]
    vertices: NDArray[np.int64]
    starts: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    coefficients: Floats

    def derivatives(self, field: Floats) -> Floats:
        """Return the derivatives (a, b, aa, ab, bb) of a field on the vertices, shape (5, k).

        Parameters
        ----------
        field
            Values, shape (n,).
        """
        owner = np.repeat(np.arange(len(self.vertices)), np.diff(self.starts))
        difference = field[self.neighbours] - field[self.vertices][owner]
        count = len(self.vertices)
        return np.stack([np.bincount(owner, difference * column, count) for column in self.coefficients.T])


def osculate(vertices_mm: Floats, faces: NDArray[np.int32], crease_deg: float | Floats) -> Osculation:
    """Fit a quadratic function of two tangent coordinates around every vertex.

    Gradients are exact to second order in the edge length, second derivatives to first order, to second order on
    regular meshes.
    Where the neighbours do not determine the second derivatives, as at the corners of a box, these are zero.

    Parameters
    ----------
    vertices_mm
        Positions, shape (n, 3).
    faces
        Vertex indices, shape (m, 3).
    crease_deg
        Faces that meet at a larger angle belong to different pieces of the surface; see `TriangleMesh`.
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
    from scipy import sparse

    ring = sparse.csr_array((np.ones(len(rows), dtype=np.int32), (rows, columns)), shape=(count, count))
    all_points = np.arange(count)
    fits = _fit(vertices_mm, vertex_of, frames, all_points, ring)
    poor = np.flatnonzero(~fits[3])
    if len(poor):
        wide = ring[poor] @ ring + ring[poor]
        again = _fit(vertices_mm, vertex_of, frames, poor, wide)
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
    return Osculation(corners, vertex_of, starts, neighbours, coefficients)


def _surface_points(
    vertices: Floats, faces: NDArray[np.int32], crease_deg: float | Floats
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the surface point at every corner, and the vertex of each."""
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    one, two, flipped = shared_sides(places_of(vertices)[faces])
    cosine = np.einsum("ij,ij->i", normals[one // 3], normals[two // 3]) * np.where(flipped, -1, 1)
    creases = np.broadcast_to(crease_deg, faces.shape).reshape(-1)
    crease = np.minimum(creases[one], creases[two])
    smooth = (cosine >= np.cos(np.deg2rad(crease))) & (crease > 0)
    one, two, flipped = one[smooth], two[smooth], flipped[smooth]
    next_one, next_two = (index - index % 3 + (index + 1) % 3 for index in (one, two))
    # Around a shared edge neighbours run in opposite senses: the first corner of one is the second of the other.
    ends = (np.where(flipped, two, next_two), np.where(flipped, next_two, two))
    rows, columns = np.concatenate([one, next_one]), np.concatenate(ends)
    count = faces.size
    from scipy import sparse

    graph = sparse.csr_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(count, count))
    number, label = sparse.csgraph.connected_components(graph, directed=False)
    vertex_of = np.empty(number, dtype=np.int64)
    vertex_of[label] = faces.ravel()
    return label.reshape(faces.shape).astype(np.int32), vertex_of


def _fit(
    vertices: Floats, vertex_of: NDArray[np.int64], frames: Floats, points: NDArray[np.int64], ring: sparse.csr_array
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Fit around some surface points.

    Returns for each the number of its neighbours, then all neighbours (vertices) and their coefficients one after the
    other, and whether the second derivatives are determined.
    """
    from scipy import sparse

    ring = sparse.csr_array(ring)
    owner = np.repeat(np.arange(len(points)), np.diff(ring.indptr))
    other = ring.indices.astype(np.int64)
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

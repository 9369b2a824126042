"""Triangles that stand twice, and components whose triangles have no common orientation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.mesh_model import find_shared_sides, index_positions
from scenetruth.scene.mesh.polygon_mesh import PolygonMesh, Triangulation

__all__ = ["MeshTopology", "describe_content", "find_repeated_polygons", "repair_topology"]

Indices = NDArray[np.int64]


class MeshTopology(NamedTuple):
    """What was done to the triangles of a file, and what they form."""

    kept: Indices
    """Triangles that are kept, shape (m,)."""
    turned: NDArray[np.bool_]
    """Those of them whose corners are taken in the opposite order, shape (m,)."""
    duplicates: int
    """Number of triangles that stood twice, in either orientation."""
    components: int
    """Number of components joined by edges of two triangles."""
    open_edges: int
    """Number of edges of a single triangle."""
    crowded_edges: int
    """Number of edges of more than two triangles, which are creases."""
    one_sided: int
    """Number of components that have no two sides, such as a Möbius strip."""


def find_repeated_polygons(vertices: NDArray[np.float64], corners: Indices, starts: Indices) -> NDArray[np.bool_]:
    """Return which polygons have the same outline as an earlier one, in either direction and from any corner.

    The triangles of such polygons can differ, because they depend on the first corner.
    """
    counts = np.diff(starts)
    repeated = np.zeros(len(counts), dtype=np.bool_)
    if not (counts > 3).any():
        # Triangles are compared by `repair_topology`.
        return repeated
    place = index_positions(vertices)[corners]
    for count in np.unique(counts[counts > 3]):
        polygons = np.flatnonzero(counts == count)
        outline = place[starts[polygons][:, None] + np.arange(count)]
        lowest = np.argmin(outline, axis=1)[:, None]
        forwards = np.take_along_axis(outline, (lowest + np.arange(count)) % count, axis=1)
        backwards = np.take_along_axis(outline, (lowest - np.arange(count)) % count, axis=1)
        # The direction whose second corner is lower.
        turned = backwards[:, 1] < forwards[:, 1]
        same = np.where(turned[:, None], backwards, forwards)
        _, first = np.unique(same, axis=0, return_index=True)
        repeated[np.delete(polygons, first)] = True
    return repeated


def repair_topology(vertices: NDArray[np.float64], triangles: Indices) -> MeshTopology:
    """Drop triangles that stand twice, and orient those of each component by the majority of its area."""
    place = index_positions(vertices)[triangles]
    same = np.sort(place, axis=1)
    _, first = np.unique(same, axis=0, return_index=True)
    kept = np.sort(first)
    place = place[kept]
    one, two, flipped = find_shared_sides(place)
    from_face, to_face = one // 3, two // 3
    # Sides of the same direction belong to triangles of opposite orientation.
    turned, components, one_sided = _orient(len(kept), from_face, to_face, flipped, _areas(vertices, triangles[kept]))
    sides = np.sort(np.stack([place, np.roll(place, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, counts = np.unique(sides, axis=0, return_counts=True)
    return MeshTopology(
        kept,
        turned,
        len(triangles) - len(kept),
        components,
        int(np.count_nonzero(counts == 1)),
        int(np.count_nonzero(counts > 2)),
        one_sided,
    )


def _areas(vertices: NDArray[np.float64], triangles: Indices) -> NDArray[np.float64]:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _orient(
    count: int, one: Indices, two: Indices, against: NDArray[np.bool_], areas: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], int, int]:
    """Return which triangles to turn, the number of components, and that of components without two sides.

    Each triangle has a twin of the opposite orientation: neighbours of the same orientation are connected with each
    other, and so are their twins; those of opposite orientation are connected with the twin of the other. A component
    has no two sides if triangles are connected with their own twins.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ones = np.ones(len(one), dtype=np.int8)
    components, plain = connected_components(coo_array((ones, (one, two)), shape=(count, count)), directed=False)
    twin = np.where(against, count, 0)
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([two + twin, two + count - twin])
    pairs = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    _, side = connected_components(pairs, directed=False)
    own, other = side[:count], side[count:]
    one_sided = np.unique(plain[own == other])
    # Of the two sides of a component, that with the larger area as the file has it.
    total = np.bincount(own, areas, minlength=int(side.max(initial=0)) + 1)
    tie = total[own] == total[other]
    turned = np.where(tie, other < own, total[other] > total[own]) & (own != other)
    return np.asarray(turned), int(components), len(one_sided)


def describe_content(
    mesh: PolygonMesh, made: Triangulation, topology: MeshTopology, repeated: int = 0
) -> tuple[str, ...]:
    """Return lines for people on what a file has: polygons, components, area, and what was ignored or changed."""
    size = float(np.linalg.norm(mesh.area_vectors(), axis=1).sum())
    polygons = len(mesh.starts) - 1
    what = f"{polygons:,} polygons, {len(topology.kept):,} triangles, {len(mesh.vertices):,} vertices"
    if topology.open_edges:
        closed = f"open ({topology.open_edges:,} edges of one triangle)"
    else:
        closed = "no manifold" if topology.crowded_edges else "closed"
    lines = [f"{what}; {topology.components:,} components, {closed}; area {size:.6g} in squares of its unit"]
    changed = [
        (made.empty, "polygons without area, ignored"),
        (repeated, "polygons that stand twice, of which one is kept"),
        (topology.duplicates, "triangles that stand twice, of which one is kept"),
        (int(np.count_nonzero(topology.turned)), "triangles turned to the orientation of their component"),
        (made.bent, "polygons that are not plane, as fans around their first corner"),
        (topology.crowded_edges, "edges of more than two triangles, which are creases"),
        (topology.one_sided, "components without two sides: their normals have no common sense"),
    ]
    lines += [f"{count:,} {text}" for count, text in changed if count]
    lines += [f"ignored: {text}" for text in mesh.ignored]
    lines += [f"material problem: {material.problem}" for material in mesh.materials if material.problem]
    return tuple(lines)

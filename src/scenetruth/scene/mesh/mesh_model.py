"""Triangle meshes: base model, grids, resolution limits and shared sides of triangles."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo

from scenetruth.number_format import format_two_digits
from scenetruth.scene.mesh.appearance import MeshAppearance
from scenetruth.scene.motion import PointMap
from scenetruth.validated_model import FrozenModel

__all__ = [
    "CREASE_DEG",
    "MeshModel",
    "MeshSize",
    "TriangleMesh",
    "check_resolution",
    "check_sheet_resolution",
    "count_pieces",
    "find_shared_sides",
    "index_positions",
    "make_disc_faces",
    "make_grid_faces",
]


_ROUNDS, _COARSER = 20, 1.1  # maximum number of coarsening steps, and minimum edge-length factor per step


class MeshSize(NamedTuple):
    """Size of a mesh."""

    vertices: int
    """Number of vertices."""
    faces: int
    """Number of triangles."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangle mesh.

    ``vertices_mm``: Positions in the object frame (X right, Y down, Z forward), shape (n, 3), float64.
    ``faces``: Vertex indices, shape (m, 3), int32.
    ``chart_mm``: Surface coordinates in mm at every face corner, shape (m, 3, 2). Faces that must not show the same
      part of a pattern have separate regions.
    ``uv``: Image-texture coordinates, shape (m, 3, 2): (0, 0) is the upper left, (1, 1) the lower right image corner.
      None if not available.
    ``tiled``: Whether ``uv`` outside [0, 1] repeats the image (files) or extends its border (generated meshes).
    ``appearance``: Colours of a file; None if it has none.
    ``file_notes``: What was read from a file, for people.
    ``cut``: Whether pictures cut parts of the surface out, so that vertices are not those of the file.
    ``crease_deg``: Angle between faces above which their edge is sharp; other edges are smooth. One angle for all, or
      one for each face side, shape (m, 3), where side k runs from corner k to corner k + 1 and the smaller angle of the
      two faces counts. 0: always sharp.
    ``material_mm``: Coordinates (a, b) of the vertices on the flat sheet, shape (n, 2), or None.
    ``shape``: Map from the sheet at (a, b, 0) to ``vertices_mm``; None if flat or not a sheet.
    ``uv_back``: As ``uv``, for the back of faces; None if both sides are the same.
    ``along``: Derivatives (a, b, aa, ab, bb) of the vertex positions along the smooth surface, shape (5, n, 3), with a
      x b outwards; None without formula, or for a sheet.
    ``smooth``: Whether the smooth surface is shaded instead of flat triangles.
    ``corner_normals``: Supplied unit normals at face corners, sign arbitrary, shape (m, 3, 3), NaN where missing.
    ``nodes_mm``, ``vertex_nodes``: Positions of all vertices of a file including unused vertices, shape (k, 3), and
      their indices for ``vertices_mm``, shape (n,); None without unused vertices.
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    chart_mm: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None
    tiled: bool = False
    crease_deg: float | NDArray[np.float64] = 1.0
    material_mm: NDArray[np.float64] | None = None
    shape: PointMap | None = None
    source: MeshModel | None = None
    uv_back: NDArray[np.float64] | None = None
    along: NDArray[np.float64] | None = None
    smooth: bool = False
    corner_normals: NDArray[np.float64] | None = None
    nodes_mm: NDArray[np.float64] | None = None
    vertex_nodes: NDArray[np.int64] | None = None
    appearance: MeshAppearance | None = None
    file_notes: tuple[str, ...] = ()
    cut: bool = False

    @property
    def with_all_nodes(self) -> TriangleMesh:
        """Mesh including the unused vertices of its file."""
        if self.nodes_mm is None or self.vertex_nodes is None:
            return self
        faces = self.vertex_nodes[self.faces].astype(np.int32)
        return replace(self, vertices_mm=self.nodes_mm, faces=faces, nodes_mm=None, vertex_nodes=None)


class MeshModel(FrozenModel):
    """Base class of meshes."""

    kind: str
    """Type of the mesh."""

    @final
    def make(self, folder: Path = Path()) -> TriangleMesh:
        """Create the mesh."""
        return replace(self.triangles(folder), source=self)

    def size(self, folder: Path) -> MeshSize:
        """Return the approximate number of vertices and faces, without creating large meshes."""
        made = self.triangles(folder)
        return MeshSize(len(made.vertices_mm), len(made.faces))

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh | None:
        """Return a coarse approximation of the mesh at low cost, or None."""
        model, faces = self, self.size(folder).faces
        for _ in range(_ROUNDS):
            resolution_mm = getattr(model, "resolution_mm", None)
            if faces <= most_faces or resolution_mm is None:
                break
            coarser = resolution_mm * max((faces / most_faces) ** 0.5, _COARSER)
            model = model.model_copy(update={"resolution_mm": coarser})
            faces = model.size(folder).faces
        return replace(model.triangles(folder), source=self)

    @abstractmethod
    def triangles(self, folder: Path) -> TriangleMesh:
        """Return vertices, faces and coordinates, see `make`."""


CREASE_DEG = 60.0
"""Default crease angle, between facet angles of smooth surfaces and edges of bodies."""


def count_pieces(length: float, longest: float) -> int:
    """Return the number of equal pieces of a length for a maximum piece length."""
    # Tolerate rounding for exact multiples.
    return max(ceil(length / longest - 1e-9), 1)


def make_grid_faces(columns: int, rows: int) -> NDArray[np.int32]:
    """Return two triangles for each cell of a grid of (rows + 1) x (columns + 1) vertices."""
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    down, right = first + columns + 1, first + 1
    both = down + 1
    faces = np.stack([np.column_stack([first, down, both]), np.column_stack([first, both, right])], axis=1)
    return faces.reshape(-1, 3).astype(np.int32)


def make_disc_faces(rings: int) -> NDArray[np.int32]:
    """Return the triangles of rings of 6, 12, 18, ... vertices around a centre; down x right points to the viewer."""
    faces = []
    for ring in range(1, rings + 1):
        outer_start = 3 * ring * (ring - 1) + 1
        inner_start = 0 if ring == 1 else outer_start - 6 * (ring - 1)
        inner_count, outer_count = max(6 * (ring - 1), 1), 6 * ring
        sector, step = np.divmod(np.arange(outer_count), ring)
        inner = sector * (ring - 1) + step
        outer = np.arange(outer_count)
        here, after = inner_start + inner % inner_count, inner_start + (inner + 1) % inner_count
        one, two = outer_start + outer, outer_start + (outer + 1) % outer_count
        faces.append(np.column_stack([here, two, one]))
        between = step < ring - 1
        faces.append(np.column_stack([here, after, two])[between])
    return np.concatenate(faces).astype(np.int32)


_MOST_TRIANGLES = 20_000_000


def check_sheet_resolution(value: float, info: ValidationInfo) -> float:
    """Validate that triangles are not longer than the shorter side of a sheet, nor too many."""
    size = info.data.get("size_mm")
    return (
        value if size is None else check_resolution(value, min(size), "the shorter of size_mm", 2 * size[0] * size[1])
    )


def check_resolution(value: float, longest_mm: float, name: str, twice_area: float) -> float:
    """Validate that a mesh is neither too coarse for its shape nor too large."""
    if value > longest_mm:
        msg = f"must be at most {name}, {longest_mm:g} mm"
        raise ValueError(msg)
    triangles = twice_area / value**2
    if triangles > _MOST_TRIANGLES:
        msg = f"gives about {format_two_digits(triangles)} triangles, more than {_MOST_TRIANGLES:.0e}; increase it"
        raise ValueError(msg)
    return value


Indices = NDArray[np.int64]


def index_positions(vertices: NDArray[np.float64]) -> Indices:
    """Return the index of the distinct position of every vertex, shape (n,)."""
    _, places = np.unique(vertices, axis=0, return_inverse=True)
    return np.asarray(places.reshape(-1), dtype=np.int64)


def find_shared_sides(corners: NDArray[np.integer]) -> tuple[Indices, Indices, NDArray[np.bool_]]:
    """Find the edges shared by exactly two triangles, from position indices (`index_positions`), shape (m, 3).

    Returns: Both sides of each edge (3 i + c: from corner c of triangle i), and whether their directions are equal.
    """
    half = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = half[:, 0] > half[:, 1]
    order = np.lexsort((half.min(axis=1), half.max(axis=1)))
    same = (np.sort(half, axis=1)[order][1:] == np.sort(half, axis=1)[order][:-1]).all(axis=1)
    # Edges of exactly two faces form a run of two.
    run = np.concatenate([[False], same, [False]])
    pairs = np.flatnonzero(run[1:-1] & ~run[:-2] & ~run[2:])
    one, two = order[pairs], order[pairs + 1]
    return one, two, turned[one] == turned[two]

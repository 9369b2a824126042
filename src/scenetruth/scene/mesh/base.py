"""What all meshes are: a model of the scene file that is made into triangles with coordinates on their surface."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from scenetruth.model import FrozenModel
from scenetruth.scene.motion import PointMap

__all__ = ["MeshModel", "MeshSize", "TriangleMesh"]

# Rounds of coarsening, and by how much each makes triangles longer at least.
_ROUNDS, _COARSER = 20, 1.1


class MeshSize(NamedTuple):
    """How large a mesh is."""

    vertices: int
    """Number of vertices."""
    faces: int
    """Number of triangles."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh.

    Parameters
    ----------
    vertices_mm
        Positions in the object's own frame (X right, Y down, Z forward), shape (n, 3), float64.
    faces
        Vertex indices, shape (m, 3), int32.
    chart_mm
        Coordinates on the surface in mm at every corner of every face, shape (m, 3, 2). Faces that must not show the
        same piece of a pattern lie in different places of the chart.
    uv
        Coordinates in a texture image, shape (m, 3, 2): (0, 0) is its upper left, (1, 1) its lower right corner.
        None if the mesh has none.
    tiled
        Whether ``uv`` outside [0, 1] repeats the image (files) or keeps its border (generated meshes).
    image
        Texture image that came with the mesh, uint8 or float, shape (h, w) or (h, w, c), or None.
    vertex_colours
        Colours that came with the mesh, uint8, shape (n, 3), or None.
    crease_deg
        Edges between faces that differ by more are edges of the object; others are parts of a smooth surface. One angle
        for all, or one for each side of every face, shape (m, 3), where side k runs from corner k to the next and the
        smaller angle of the two faces counts. 0: an edge whatever the angle.
    material_mm
        Coordinates (a, b) of the vertices on the flat sheet that the mesh is made from, shape (n, 2), or None.
    shape
        The map of that sheet, at (a, b, 0), to ``vertices_mm``; None if it is flat, or no sheet.
    source
        The model that it was made from, or None.
    uv_back
        As ``uv``, for whoever sees a face from behind, so that its corners run the other way round; None if both sides
        show the same.
    along
        Derivatives (a, b, aa, ab, bb) of the vertices' positions by two coordinates along the smooth surface that the
        mesh stands for, shape (5, n, 3), with a x b to the outside; None if it has no formula, or is a sheet.
    smooth
        Whether light falls on the smooth surface that the mesh stands for between its edges, not on flat triangles.
    corner_normals
        Unit normals that came with the mesh, at every corner of every face, of either sense, shape (m, 3, 3), NaN where
        there is none; None if it brought none.
    nodes_mm, vertex_nodes
        Positions of all vertices of a file some of which no face uses, shape (k, 3), and which of them ``vertices_mm``
        are, shape (n,); None where faces use all.
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    chart_mm: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None
    tiled: bool = False
    image: NDArray[Any] | None = None
    vertex_colours: NDArray[np.uint8] | None = None
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

    @property
    def with_all_nodes(self) -> TriangleMesh:
        """The mesh with the vertices of its file that no face uses: its colours are left out."""
        if self.nodes_mm is None or self.vertex_nodes is None:
            return self
        faces = self.vertex_nodes[self.faces].astype(np.int32)
        return replace(
            self, vertices_mm=self.nodes_mm, faces=faces, vertex_colours=None, nodes_mm=None, vertex_nodes=None
        )


class MeshModel(FrozenModel):
    """What all meshes share."""

    kind: str
    """Name of the shape."""

    @final
    def make(self, folder: Path = Path()) -> TriangleMesh:
        """Make the mesh.

        Parameters
        ----------
        folder
            Where relative paths count from.

        Raises
        ------
        SceneError
            If it cannot be made; paths count from the mesh.
        """
        return replace(self.triangles(folder), source=self)

    def size(self, folder: Path) -> MeshSize:
        """Return how many vertices and faces the mesh will have; what may be large counts without being made.

        Parameters
        ----------
        folder
            Where relative paths count from.

        Raises
        ------
        SceneError
            If a file cannot be read; paths count from the mesh.
        """
        made = self.triangles(folder)
        return MeshSize(len(made.vertices_mm), len(made.faces))

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh | None:
        """Return a coarse mesh of about the same form, cheap to make.

        Parameters
        ----------
        folder
            Where relative paths count from.
        most_faces
            About how many triangles it may have.

        Returns
        -------
        TriangleMesh or None
            None if nothing is known of the form without much work.
        """
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
        """Return vertices, faces and coordinates; see `make`."""

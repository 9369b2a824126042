"""Mesh files, with the normals and creases that they define."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import InputFile
from scenetruth.scene.mesh.appearance import MeshAppearance
from scenetruth.scene.mesh.cutouts import weld
from scenetruth.scene.mesh.file_preflight import count_elements, read_unchanged, refuse_mesh_file
from scenetruth.scene.mesh.gltf_document import GltfDocument
from scenetruth.scene.mesh.gltf_file import read_gltf
from scenetruth.scene.mesh.mesh_model import (
    CREASE_DEG,
    MeshModel,
    MeshSize,
    TriangleMesh,
    find_shared_sides,
    index_positions,
)
from scenetruth.scene.mesh.obj_file import list_obj_references, read_obj
from scenetruth.scene.mesh.ply_file import list_ply_references, read_ply
from scenetruth.scene.mesh.polygon_mesh import MeshFileError, PolygonMesh, Triangulation, triangulate
from scenetruth.scene.mesh.stl_off_files import read_off, read_stl
from scenetruth.scene.mesh.topology_repair import describe_content, find_repeated_polygons, repair_topology
from scenetruth.validated_model import Positive

__all__ = ["FileMesh", "list_referenced_files", "load_mesh_file"]


_SAME_DEG = 1.0  # angle below which normals count as equal, allowing for rounding in the file


def compute_crease_angles(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], corner_normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the crease angle of every side of every triangle, see `TriangleMesh.crease_deg`.

    An edge whose two triangles have equal normals at both ends is smooth, unless the triangles differ by more than
    facets of a smooth surface; with different normals it is sharp. Without normals, the angle between the triangles
    decides.

    ``corner_normals``: Unit normals at the corners, sign arbitrary, shape (m, 3, 3); NaN for none.
    Returns: Angles in degrees, shape (m, 3): `CREASE_DEG`, or 0 for sharp edges.
    """
    one, two, flipped = find_shared_sides(index_positions(vertices)[faces])
    next_one, next_two = (side - side % 3 + (side + 1) % 3 for side in (one, two))
    normals = corner_normals.reshape(-1, 3)
    sharp = np.zeros(len(one), dtype=np.bool_)
    for first, second in ((one, np.where(flipped, two, next_two)), (next_one, np.where(flipped, next_two, two))):
        cosine = np.abs(np.einsum("ij,ij->i", normals[first], normals[second]))
        # Comparisons with NaN are false.
        sharp |= cosine < np.cos(np.deg2rad(_SAME_DEG))
    creases = np.full(faces.size, CREASE_DEG)
    creases[one[sharp]] = creases[two[sharp]] = 0.0
    return creases.reshape(-1, 3)


_QUICKLY_READ = 2_000_000  # maximum file size in bytes for reading within some tenths of a second


class FileMesh(MeshModel):
    """Triangle mesh from a file (OBJ, PLY, GLB, STL); coordinates X right, Y down, Z forward."""

    kind: Literal["file"]
    """``file``."""
    file: InputFile
    """Path of the file; relative paths refer to the directory of the scene file."""
    unit_mm: Positive = 1.0
    """Length of the unit of the file in mm."""
    crease_deg: Annotated[float, Field(gt=0, le=180)] | None = None
    """Crease angle in degrees: edges between faces that differ by more are sharp, all others smooth. null: derived from
    the normals of the file (OBJ ``vn``, PLY ``nx ny nz``, glTF ``NORMAL``): sharp where they are discontinuous or faces
    differ by more than 60; 60 for files without normals. If specified, the normals of the file are ignored.
    """

    def size(self, folder: Path) -> MeshSize:
        """Return the approximate size without parsing the file, see `MeshModel`."""

        def count(file: Path) -> MeshSize:
            refuse_mesh_file(file)
            return MeshSize(*count_elements(file))

        return read_unchanged(folder / self.file, count)

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh | None:
        """Return the mesh itself, or None for large files, see `MeshModel`."""
        refuse_mesh_file(folder / self.file)
        return self.make(folder) if (folder / self.file).stat().st_size <= _QUICKLY_READ else None

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return load_mesh_file(folder / self.file, self.unit_mm, self.crease_deg)


_READERS: dict[str, Callable[[Path], PolygonMesh]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
}


_REFERENCES: dict[str, Callable[[Path], list[Path]]] = {
    ".obj": list_obj_references,
    ".ply": list_ply_references,
    ".glb": lambda file: GltfDocument(file).list_references(),
    ".gltf": lambda file: GltfDocument(file).list_references(),
}


def list_referenced_files(file: Path) -> list[Path]:
    """Return the files that a mesh file refers to: material libraries, pictures and buffers; empty if it is invalid."""
    reader = _REFERENCES.get(file.suffix.lower())
    try:
        return [] if reader is None else reader(file)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):  # reported when the mesh is read
        return []


def load_mesh_file(file: Path, unit_mm: float = 1.0, crease_deg: float | None = None) -> TriangleMesh:
    """Load the polygons of a mesh file as triangles; the unit of the file is ``unit_mm``."""
    return read_unchanged(file, partial(_load, unit_mm=unit_mm, crease_deg=crease_deg))


def _load(file: Path, unit_mm: float, crease_deg: float | None) -> TriangleMesh:
    refuse_mesh_file(file)
    try:
        mesh = _READERS[file.suffix.lower()](file)
        finite = np.isfinite(mesh.vertices).all(axis=1)
        if not finite.all():
            msg = f"has {np.count_nonzero(~finite)} vertices that are not finite"
            raise MeshFileError(msg)
        mesh = mesh.without_repeated_corners()
        made = triangulate(mesh)
        if not len(made.corners):
            msg = "has only faces of zero area"
            raise MeshFileError(msg)
        return _as_triangles(mesh, made, file, unit_mm, crease_deg)
    except MeshFileError as error:
        raise SceneError([Problem("file", str(error), str(file))]) from error
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        # Arbitrary bytes and JSON raise various exceptions.
        message = f"cannot be read as a mesh: {' '.join(str(error).split())[:200] or type(error).__name__}"
        raise SceneError([Problem("file", message, str(file))]) from error


def _as_triangles(
    mesh: PolygonMesh, made: Triangulation, file: Path, unit_mm: float, crease_deg: float | None
) -> TriangleMesh:
    """Return the triangles of polygons, oriented consistently, without those that stand twice or are cut out."""
    repeated = find_repeated_polygons(mesh.vertices, mesh.corners, mesh.starts)
    once = ~repeated[made.polygon]
    made = made._replace(corners=made.corners[once], polygon=made.polygon[once])
    topology = repair_topology(mesh.vertices, mesh.corners[made.corners])
    corners, owner = made.corners[topology.kept], made.polygon[topology.kept]
    corners[topology.turned] = corners[topology.turned][:, ::-1]
    of_file, points = mesh.corners[corners], mesh.vertices * unit_mm
    notes = describe_content(mesh, made, topology, int(np.count_nonzero(repeated)))
    appearance = MeshAppearance(
        None if mesh.colours is None else mesh.colours[corners],
        None if mesh.uv is None else mesh.uv[corners],
        mesh.materials,
        mesh.material_of[owner],
        True if file.suffix.lower() in (".glb", ".gltf") else None,
    )
    normals = None if crease_deg is not None or mesh.normals is None else mesh.normals[corners]
    # Unused vertices are invisible and matter only for arrays of nodes.
    used = np.unique(of_file)
    nodes = points if len(used) < len(points) else None
    vertices, corner_vertices = points[used], np.searchsorted(used, of_file)
    cut = appearance.cut()
    if cut is not None:
        if not len(cut.source):
            msg = "has no surface left: its pictures are transparent everywhere"
            raise MeshFileError(msg)
        welded = weld(corner_vertices, cut)
        vertices = np.einsum("nc,nci->ni", welded.weights, vertices[corner_vertices[welded.source]])
        corner_vertices, nodes, appearance = welded.triangles, None, appearance.on_pieces(cut)
        normals = None if normals is None else np.einsum("tkc,tcj->tkj", cut.weights, normals[cut.source])
        notes += (f"{cut.cut:,} triangles cut along the outline of their picture's opacity, {cut.removed:,} removed",)
    faces = corner_vertices.astype(np.int32)
    if normals is not None:
        normals = _unit(normals)
        crease: float | NDArray[np.float64] = compute_crease_angles(vertices, faces, normals)
    else:
        crease = CREASE_DEG if crease_deg is None else crease_deg
    uv = appearance.uv
    return TriangleMesh(
        vertices,
        faces,
        _box_projection(vertices, faces),
        # v increases upwards in mesh files, image rows increase downwards.
        None if uv is None or not np.isfinite(uv).all() else uv * (1, -1) + (0, 1),
        True,
        crease_deg=crease,
        smooth=True,
        corner_normals=normals,
        nodes_mm=nodes,
        vertex_nodes=None if nodes is None else used,
        appearance=appearance if appearance.has_colours else None,
        file_notes=notes,
        cut=cut is not None,
    )


def _unit(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit normals, NaN where they are missing or of no length."""
    with np.errstate(divide="ignore", invalid="ignore"):
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~np.isfinite(normals).all(axis=-1)] = np.nan
    return normals


def _face_normals(vertices: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    corners = vertices[faces]
    normals: NDArray[np.float64] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def _box_projection(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Project each face along the axis closest to its normal; each of the six directions has its own chart region."""
    normals = _face_normals(vertices, faces)
    axis = np.argmax(np.abs(normals), axis=1)
    sign = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    corners = (vertices - low)[faces]
    cell = np.array([max(extent[0], extent[2]), max(extent[1], extent[2])])
    chart = np.empty((len(faces), 3, 2))
    for normal_axis, (across, down) in enumerate(((2, 1), (0, 2), (0, 1))):
        chosen = axis == normal_axis
        chart[chosen] = corners[chosen][:, :, [across, down]]
    chart[..., 0] += (axis * cell[0])[:, None]
    chart[..., 1] += (sign * cell[1])[:, None]
    return chart

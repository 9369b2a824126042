"""Mesh files, with the normals and creases that they define."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import InputFile
from scenetruth.scene.mesh.file_preflight import (
    MAX_ELEMENTS,
    MAX_TEXELS,
    count_elements,
    make_checked_resolver,
    refuse_mesh_file,
)
from scenetruth.scene.mesh.mesh_model import (
    CREASE_DEG,
    MeshModel,
    MeshSize,
    TriangleMesh,
    find_shared_sides,
    index_positions,
)
from scenetruth.validated_model import Positive

__all__ = ["FileMesh", "load_mesh_file"]


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
        refuse_mesh_file(folder / self.file)
        return MeshSize(*count_elements(folder / self.file))

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh | None:
        """Return the mesh itself, or None for large files, see `MeshModel`."""
        refuse_mesh_file(folder / self.file)
        return self.make(folder) if (folder / self.file).stat().st_size <= _QUICKLY_READ else None

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return load_mesh_file(folder / self.file, self.unit_mm, self.crease_deg)


def load_mesh_file(file: Path, unit_mm: float = 1.0, crease_deg: float | None = None) -> TriangleMesh:
    """Load a mesh file with trimesh; the unit of the file is ``unit_mm``."""
    import trimesh

    refuse_mesh_file(file)
    try:
        parts = trimesh.load_scene(file, process=False, resolver=make_checked_resolver(file))
        # Before the parts are merged, which discards normals.
        normals = None if crease_deg is not None else _vertex_normals(parts)
        loaded = parts.to_mesh()
    except Exception as error:  # trimesh raises various exceptions
        message = f"cannot be read as a mesh: {' '.join(str(error).split())[:200] or type(error).__name__}"
        raise SceneError([Problem("file", message, str(file))]) from error
    faces = np.asarray(getattr(loaded, "faces", ()), dtype=np.int64)
    if faces.ndim != 2 or len(faces) == 0:
        raise SceneError([Problem("file", "has no faces", str(file))])
    if max(len(faces), len(loaded.vertices)) > MAX_ELEMENTS:
        message = f"has {len(loaded.vertices):,} vertices and {len(faces):,} faces; the maximum is {MAX_ELEMENTS:,}"
        raise SceneError([Problem("file", message, str(file))])
    vertices = np.asarray(loaded.vertices, dtype=np.float64) * unit_mm
    if not np.all(np.isfinite(vertices)):
        count = int(np.sum(~np.isfinite(vertices).all(axis=1)))
        raise SceneError([Problem("file", f"has {count} vertices that are not finite", str(file))])
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError([Problem("file", "has faces with invalid vertex indices", str(file))])
    used = np.unique(faces)
    areas = np.linalg.norm(_face_normals(vertices, faces), axis=1)
    # Degenerate faces of zero area are dropped, which does not change the shape.
    faces = faces[areas > 1e-14 * max(float(areas.max()), 1e-300)].astype(np.int32)
    if len(faces) == 0:
        raise SceneError([Problem("file", "has only faces of zero area", str(file))])
    try:
        uv, image, colours = _appearance(loaded, faces)
    except Exception as error:  # damaged images raise various exceptions
        message = f"has an unreadable texture image or vertex colours: {' '.join(str(error).split())[:200]}"
        raise SceneError([Problem("file", message, str(file))]) from error
    corner_normals = None if normals is None else normals[faces]
    nodes = None
    if len(used) < len(vertices):
        # Unused vertices are invisible and matter only for arrays of nodes.
        nodes, vertices, faces = vertices, vertices[used], np.searchsorted(used, faces).astype(np.int32)
        colours = None if colours is None else colours[used]
    if corner_normals is not None:
        crease: float | NDArray[np.float64] = compute_crease_angles(vertices, faces, corner_normals)
    else:
        crease = CREASE_DEG if crease_deg is None else crease_deg
    return TriangleMesh(
        vertices,
        faces,
        _box_projection(vertices, faces),
        uv,
        True,
        image,
        colours,
        crease,
        smooth=True,
        corner_normals=corner_normals,
        nodes_mm=nodes,
        vertex_nodes=None if nodes is None else used,
    )


def _vertex_normals(parts: Any) -> NDArray[np.float64] | None:
    """Return the unit vertex normals of a file, shape (n, 3), NaN where missing or invalid; None if there are none."""
    import trimesh

    found, brought = [], False
    for node in parts.graph.nodes_geometry:
        to_world, name = parts.graph[node]
        part = parts.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        # Value set by the loader; the public property would compute missing normals.
        own = part._cache.cache.get("vertex_normals")
        brought |= own is not None
        normals = np.full((len(part.vertices), 3), np.nan) if own is None else np.asarray(own, dtype=np.float64)
        linear = np.asarray(to_world, dtype=np.float64)[:3, :3]
        # Normals transform by the cofactor matrix of the point transform.
        normals = normals @ np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        normals[~np.isfinite(normals).all(axis=1)] = np.nan
        found.append(normals)
    return np.concatenate(found) if brought else None


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


def _appearance(
    loaded: Any, faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64] | None, NDArray[Any] | None, NDArray[np.uint8] | None]:
    visual = loaded.visual
    if getattr(visual, "kind", None) == "texture" and getattr(visual, "uv", None) is not None:
        # v increases upwards in mesh files, image rows increase downwards.
        uv = np.asarray(visual.uv, dtype=np.float64) * (1, -1) + (0, 1)
        material = visual.material
        picture = getattr(material, "baseColorTexture", None)
        if picture is None:
            picture = getattr(material, "image", None)
        if not np.isfinite(uv).all():
            msg = "texture coordinates that are not finite"
            raise ValueError(msg)
        if picture is not None and picture.size[0] * picture.size[1] > MAX_TEXELS:
            msg = f"{picture.size[0]} x {picture.size[1]} pixels, more than {MAX_TEXELS:,}"
            raise ValueError(msg)
        return uv[faces], None if picture is None else np.asarray(picture.convert("RGB")), None
    if getattr(visual, "kind", None) == "vertex":
        return None, None, np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3]
    return None, None, None

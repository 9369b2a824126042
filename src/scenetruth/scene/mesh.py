"""Triangle meshes in their own frame, with coordinates on their surface for textures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene import spec
from scenetruth.scene.motion import PointMap

__all__ = ["TriangleMesh", "box", "leaf", "load", "make_mesh", "plane"]


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
        Edges between faces that differ by more are edges of the object; others are parts of a smooth surface.
    material_mm
        Coordinates (a, b) of the vertices on the flat sheet that the mesh is made from, shape (n, 2), or None.
    shape
        The map of that sheet, at (a, b, 0), to ``vertices_mm``; None if it is flat, or no sheet.
    leaf
        The leaf that it is, or None.
    uv_back
        As ``uv``, for whoever sees a face from behind, so that its corners run the other way round; None if both sides
        show the same.
    along
        Derivatives (a, b, aa, ab, bb) of the vertices' positions by two coordinates along the smooth surface that the
        mesh stands for, shape (5, n, 3), with a x b to the outside; None if it has no formula, or is a sheet.
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    chart_mm: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None
    tiled: bool = False
    image: NDArray[Any] | None = None
    vertex_colours: NDArray[np.uint8] | None = None
    crease_deg: float = 1.0
    material_mm: NDArray[np.float64] | None = None
    shape: PointMap | None = None
    leaf: spec.LeafMesh | None = None
    uv_back: NDArray[np.float64] | None = None
    along: NDArray[np.float64] | None = None


def make_mesh(entry: spec.Mesh, folder: Path) -> TriangleMesh:
    """Make the mesh that a scene describes.

    Parameters
    ----------
    entry
        The mesh of the scene.
    folder
        Where relative paths count from.

    Raises
    ------
    SceneError
        If a mesh file is missing or unusable; paths count from the mesh.
    """
    if isinstance(entry, spec.BoxMesh):
        return box(entry.size_mm)
    if isinstance(entry, spec.PlaneMesh) and entry.resolution_mm is None:
        return plane(entry.size_mm)
    if isinstance(entry, spec.LeafMesh):
        return leaf(entry)
    if not isinstance(entry, spec.FileMesh):
        return _surface(entry)
    return load(folder / entry.file, entry.unit_mm)


def _surface(
    entry: spec.PlaneMesh | spec.SphereMesh | spec.CylinderMesh | spec.SaddleMesh | spec.ReliefMesh | spec.StairsMesh,
) -> TriangleMesh:
    from scenetruth.scene import surfaces

    if isinstance(entry, spec.PlaneMesh):
        return surfaces.sheet(entry.size_mm, entry.resolution_mm or max(entry.size_mm))
    if isinstance(entry, spec.SphereMesh):
        if entry.cap_deg is not None:
            return surfaces.spherical_cap(entry.radius_mm, entry.cap_deg, entry.resolution_mm)
        return surfaces.sphere(entry.radius_mm, entry.resolution_mm)
    if isinstance(entry, spec.CylinderMesh):
        return surfaces.cylinder(entry.radius_mm, entry.length_mm, entry.resolution_mm, entry.caps)
    if isinstance(entry, spec.SaddleMesh):
        return surfaces.saddle(entry.size_mm, entry.curvature_per_mm, entry.resolution_mm)
    if isinstance(entry, spec.ReliefMesh):
        return surfaces.relief(
            entry.size_mm, entry.amplitude_mm, entry.wavelength_mm, entry.phase_deg, entry.resolution_mm
        )
    return surfaces.stairs(entry.tread_mm, entry.steps_mm, entry.risers)


def plane(size_mm: tuple[float, float]) -> TriangleMesh:
    """Return a rectangle in the XY plane with its normal towards the camera (-Z)."""
    half = np.asarray(size_mm) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
    faces = np.array([[0, 3, 2], [0, 2, 1]], dtype=np.int32)
    flat = corners * half
    vertices = np.column_stack([flat, np.zeros(4)])
    return TriangleMesh(vertices, faces, chart_mm=flat[faces], uv=((corners + 1) / 2)[faces])


def box(size_mm: tuple[float, float, float]) -> TriangleMesh:
    """Return a box centred on the origin, each side with a place of its own in the chart.

    Seen from outside, each side shows an image texture whole and upright as far as it can be.
    """
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
    vertices = signs * (np.asarray(size_mm) / 2)
    # The corners of each side, clockwise on screen from its upper left when seen from outside.
    sides = ((0, 1, 3, 2), (1, 5, 7, 3), (5, 4, 6, 7), (4, 0, 2, 6), (4, 5, 1, 0), (2, 3, 7, 6))
    width, height = (max(size_mm[0], size_mm[2]), max(size_mm[1], size_mm[2]))
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
    faces, chart, uv = [], [], []
    for index, side in enumerate(sides):
        across = np.linalg.norm(vertices[side[1]] - vertices[side[0]])
        down = np.linalg.norm(vertices[side[3]] - vertices[side[0]])
        place = np.array([index % 3 * width, index // 3 * height])
        for corners in ((0, 3, 2), (0, 2, 1)):
            faces.append([side[corner] for corner in corners])
            chart.append(unit[list(corners)] * (across, down) + place)
            uv.append(unit[list(corners)])
    return TriangleMesh(vertices, np.array(faces, dtype=np.int32), np.array(chart), uv=np.array(uv))


def leaf(entry: spec.LeafMesh) -> TriangleMesh:
    """Return a leaf; its chart is the flat sheet itself, petiole included, and an image covers the blade.

    Raises
    ------
    SceneError
        If its margin meets itself; paths count from the mesh.
    """
    from scenetruth.scene.leaf_mesh import leaf_sheet
    from scenetruth.scene.leaf_outline import entire_margin
    from scenetruth.scene.leaf_shape import shape_of

    material, faces = leaf_sheet(entry)
    shape = shape_of(entry)
    a, b = material.T
    vertices = np.column_stack(shape((a, b, np.zeros_like(a)), np.zeros(1)))
    behind, half = float(entire_margin(entry)[:, 0].min()), entry.full_width_mm / 2
    image = (material - (behind, -half)) / (entry.length_mm - behind, 2 * half)
    return TriangleMesh(
        vertices,
        faces,
        chart_mm=material[faces],
        uv=image[faces],
        crease_deg=60.0,
        material_mm=material,
        shape=shape,
        leaf=entry,
    )


def load(file: Path, unit_mm: float = 1.0) -> TriangleMesh:
    """Load a mesh file with trimesh.

    Parameters
    ----------
    file
        OBJ, PLY, GLB or STL. Its coordinates are taken as X right, Y down, Z forward.
    unit_mm
        Length of the file's unit in mm.

    Raises
    ------
    SceneError
        If the file is missing, unreadable, without faces, or holds numbers that are not finite.
    """
    import trimesh

    if not file.is_file():
        raise SceneError([Problem("file", "no such mesh file", str(file))])
    try:
        loaded = trimesh.load(file, force="mesh", process=False)
    except Exception as error:  # trimesh's loaders raise whatever their formats raise
        raise SceneError([Problem("file", f"cannot be read as a mesh: {error}", str(file))]) from error
    faces = np.asarray(getattr(loaded, "faces", ()), dtype=np.int64)
    if faces.ndim != 2 or len(faces) == 0:
        raise SceneError([Problem("file", "has no faces", str(file))])
    vertices = np.asarray(loaded.vertices, dtype=np.float64) * unit_mm
    if not np.all(np.isfinite(vertices)):
        count = int(np.sum(~np.isfinite(vertices).all(axis=1)))
        raise SceneError([Problem("file", f"has {count} vertices that are not finite", str(file))])
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError([Problem("file", "has faces that refer to vertices which do not exist", str(file))])
    areas = np.linalg.norm(_face_normals(vertices, faces), axis=1)
    # A sliver without area has no normal and no surface; it can be dropped without changing the shape.
    faces = faces[areas > 1e-14 * max(float(areas.max()), 1e-300)].astype(np.int32)
    if len(faces) == 0:
        raise SceneError([Problem("file", "has only faces without area", str(file))])
    uv, image, colours = _appearance(loaded, faces)
    return TriangleMesh(vertices, faces, _box_projection(vertices, faces), uv, True, image, colours)


def _face_normals(vertices: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    corners = vertices[faces]
    normals: NDArray[np.float64] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def _box_projection(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Project each face along the axis nearest to its normal; each of the six directions has a place of its own."""
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
        # Mesh files count v upwards from the image's lower edge, an image counts its rows downwards.
        uv = np.asarray(visual.uv, dtype=np.float64) * (1, -1) + (0, 1)
        material = visual.material
        picture = getattr(material, "baseColorTexture", None)
        if picture is None:
            picture = getattr(material, "image", None)
        return uv[faces], None if picture is None else np.asarray(picture.convert("RGB")), None
    if getattr(visual, "kind", None) == "vertex":
        return None, None, np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3]
    return None, None, None

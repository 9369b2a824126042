"""Rectangular sheets, flat or shaped by a map."""

from __future__ import annotations

import numpy as np

from scenetruth.scene.mesh.base import MeshSize, TriangleMesh
from scenetruth.scene.mesh.grid import CREASE_DEG, grid_faces, pieces
from scenetruth.scene.motion import PointMap, Points

__all__ = ["sheet", "sheet_size"]


def sheet_size(size_mm: tuple[float, float], resolution_mm: float) -> MeshSize:
    """Return how large a sheet is; see `sheet`."""
    columns, rows = (pieces(length, resolution_mm) for length in size_mm)
    return MeshSize((columns + 1) * (rows + 1), 2 * columns * rows)


def sheet(size_mm: tuple[float, float], resolution_mm: float, shape: PointMap | None = None) -> TriangleMesh:
    """Return a rectangular sheet in the XY plane, its upper side towards -Z, shaped by a map.

    Texture coordinates are those of the flat sheet: a shape that stretches it stretches its texture.

    Parameters
    ----------
    size_mm
        Edge lengths along X and Y, mm.
    resolution_mm
        Longest edge of the triangles along X and Y in the flat, mm.
    shape
        The map from the flat into the form, or None.
    """
    columns, rows = (pieces(length, resolution_mm) for length in size_mm)
    across, down = (np.linspace(-0.5, 0.5, count + 1) for count in (columns, rows))
    unit = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    material = unit * size_mm
    points: Points = (*np.ascontiguousarray(material.T), np.zeros(len(material)))
    if shape is not None:
        points = shape(points, np.zeros(1))
    vertices = np.column_stack(np.broadcast_arrays(*points))
    faces = grid_faces(columns, rows)
    return TriangleMesh(
        vertices,
        faces,
        chart_mm=material[faces],
        uv=(unit + 0.5)[faces],
        crease_deg=CREASE_DEG,
        material_mm=material,
        shape=shape,
    )

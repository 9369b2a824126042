"""Rectangular sheets: planes, sinusoidal reliefs and saddles."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.scene.mesh.mesh_model import (
    CREASE_DEG,
    MeshModel,
    MeshSize,
    TriangleMesh,
    check_sheet_resolution,
    count_pieces,
    make_grid_faces,
)
from scenetruth.scene.motion import PointMap, Points
from scenetruth.scene.taylor import JetField
from scenetruth.validated_model import Finite, Positive

__all__ = ["PlaneMesh", "ReliefMesh", "SaddleMesh", "make_plane", "make_relief", "make_saddle", "make_sheet"]


def compute_sheet_size(size_mm: tuple[float, float], resolution_mm: float) -> MeshSize:
    """Return the mesh size of a sheet, see `make_sheet`."""
    columns, rows = (count_pieces(length, resolution_mm) for length in size_mm)
    return MeshSize((columns + 1) * (rows + 1), 2 * columns * rows)


def make_sheet(size_mm: tuple[float, float], resolution_mm: float, shape: PointMap | None = None) -> TriangleMesh:
    """Return a rectangular sheet in the XY plane, upper side towards -Z, shaped by a map.

    ``resolution_mm``, the longest edge along X and Y, and texture coordinates refer to the flat sheet.
    """
    columns, rows = (count_pieces(length, resolution_mm) for length in size_mm)
    across, down = (np.linspace(-0.5, 0.5, count + 1) for count in (columns, rows))
    unit = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    material = unit * size_mm
    points: Points = (*np.ascontiguousarray(material.T), np.zeros(len(material)))
    if shape is not None:
        points = shape(points, np.zeros(1))
    vertices = np.column_stack(np.broadcast_arrays(*points))
    faces = make_grid_faces(columns, rows)
    return TriangleMesh(
        vertices,
        faces,
        chart_mm=material[faces],
        uv=(unit + 0.5)[faces],
        crease_deg=CREASE_DEG,
        material_mm=material,
        shape=shape,
    )


class PlaneMesh(MeshModel):
    """Rectangle in the XY plane facing the camera (normal -Z), centred on the origin."""

    kind: Literal["plane"]
    """``plane``."""
    size_mm: tuple[Positive, Positive]
    """Edge lengths along X and Y in mm."""
    resolution_mm: Positive | None = None
    """Longest triangle edge along X and Y in mm, for in-plane deformation; null for two triangles."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float | None, info: ValidationInfo) -> float | None:
        return value if value is None else check_sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        return MeshSize(4, 2) if self.resolution_mm is None else compute_sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_plane(self.size_mm) if self.resolution_mm is None else make_sheet(self.size_mm, self.resolution_mm)


def make_plane(size_mm: tuple[float, float]) -> TriangleMesh:
    """Return a rectangle in the XY plane with its normal towards the camera (-Z)."""
    half = np.asarray(size_mm) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
    faces = np.array([[0, 3, 2], [0, 2, 1]], dtype=np.int32)
    flat = corners * half
    vertices = np.column_stack([flat, np.zeros(4)])
    return TriangleMesh(vertices, faces, chart_mm=flat[faces], uv=((corners + 1) / 2)[faces])


_PIECES_PER_WAVE = 4  # minimum number of triangles per wavelength


class ReliefMesh(MeshModel):
    """Relief Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y) over a rectangle: a sheet, upper side -Z."""

    kind: Literal["relief"]
    """``relief``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    amplitude_mm: Finite
    """Height of the crests above the mean plane in mm, towards the camera."""
    wavelength_mm: tuple[Positive | None, Positive | None]
    """Wavelengths λ_X and λ_Y in mm; null for constant height along an axis."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases φ_X and φ_Y at the origin in degrees."""
    resolution_mm: Positive = 0.5
    """Longest triangle edge of the flat sheet along X and Y in mm; at most a quarter of a wavelength."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        waves = [length for length in info.data.get("wavelength_mm", ()) if length is not None]
        if waves and value > min(waves) / _PIECES_PER_WAVE:
            msg = f"must be at most a quarter of wavelength_mm, {min(waves) / _PIECES_PER_WAVE:g} mm"
            raise ValueError(msg)
        return check_sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        return compute_sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_relief(self.size_mm, self.amplitude_mm, self.wavelength_mm, self.phase_deg, self.resolution_mm)


def make_relief(
    size_mm: tuple[float, float],
    amplitude_mm: float,
    wavelength_mm: tuple[float | None, float | None],
    phase_deg: tuple[float, float],
    resolution_mm: float,
) -> TriangleMesh:
    """Return the relief Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y); constant for λ = None."""
    rates = [0.0 if length is None else 2 * np.pi / length for length in wavelength_mm]
    phases = np.deg2rad(phase_deg)

    def shape(points: Points, t: JetField) -> Points:
        x, y, z = points
        return x, y, z - amplitude_mm * np.cos(rates[0] * x + phases[0]) * np.cos(rates[1] * y + phases[1])

    return make_sheet(size_mm, resolution_mm, shape)


class SaddleMesh(MeshModel):
    """Saddle Z = curvature (X² - Y²) / 2 over a rectangle: a sheet with its upper side towards -Z."""

    kind: Literal["saddle"]
    """``saddle``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    curvature_per_mm: Finite
    """Curvature at the centre in 1/mm; positive: the left and right ends are farther from the camera."""
    resolution_mm: Positive = 0.5
    """Longest triangle edge of the flat sheet along X and Y in mm."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        return check_sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        return compute_sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_saddle(self.size_mm, self.curvature_per_mm, self.resolution_mm)


def make_saddle(size_mm: tuple[float, float], curvature_per_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return the saddle Z = curvature (X² - Y²) / 2 over a rectangle."""

    def shape(points: Points, t: JetField) -> Points:
        x, y, z = points
        return x, y, z + curvature_per_mm / 2 * (x * x - y * y)

    return make_sheet(size_mm, resolution_mm, shape)

"""A saddle."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import ValidationInfo, field_validator

from scenetruth.model import Finite, Positive
from scenetruth.scene.jets import Field
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.resolution import sheet_resolution
from scenetruth.scene.mesh.sheet import sheet, sheet_size
from scenetruth.scene.motion import Points

__all__ = ["SaddleMesh", "saddle"]


class SaddleMesh(MeshModel):
    """The saddle Z = curvature (X² - Y²) / 2 over a rectangle: a sheet with its upper side towards -Z."""

    kind: Literal["saddle"]
    """``saddle``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    curvature_per_mm: Finite
    """Curvature at the middle in 1/mm; positive: its left and right ends are farther from the camera."""
    resolution_mm: Positive = 0.5
    """Longest edge of the flat sheet's triangles along X and Y in mm."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        return sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        return sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return saddle(self.size_mm, self.curvature_per_mm, self.resolution_mm)


def saddle(size_mm: tuple[float, float], curvature_per_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return the saddle Z = curvature (X² - Y²) / 2 over a rectangle."""

    def shape(points: Points, t: Field) -> Points:
        x, y, z = points
        return x, y, z + curvature_per_mm / 2 * (x * x - y * y)

    return sheet(size_mm, resolution_mm, shape)

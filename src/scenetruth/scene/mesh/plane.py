"""A rectangle."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Positive
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.resolution import sheet_resolution
from scenetruth.scene.mesh.sheet import sheet, sheet_size

__all__ = ["PlaneMesh", "plane"]


class PlaneMesh(MeshModel):
    """A rectangle in the XY plane that faces the camera (normal -Z), centred on its origin."""

    kind: Literal["plane"]
    """``plane``."""
    size_mm: tuple[Positive, Positive]
    """Edge lengths along X and Y in mm."""
    resolution_mm: Positive | None = None
    """Longest edge of the triangles along X and Y in mm, for deformations within the plane; null for two triangles."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float | None, info: ValidationInfo) -> float | None:
        return value if value is None else sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        return MeshSize(4, 2) if self.resolution_mm is None else sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return plane(self.size_mm) if self.resolution_mm is None else sheet(self.size_mm, self.resolution_mm)


def plane(size_mm: tuple[float, float]) -> TriangleMesh:
    """Return a rectangle in the XY plane with its normal towards the camera (-Z)."""
    half = np.asarray(size_mm) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
    faces = np.array([[0, 3, 2], [0, 2, 1]], dtype=np.int32)
    flat = corners * half
    vertices = np.column_stack([flat, np.zeros(4)])
    return TriangleMesh(vertices, faces, chart_mm=flat[faces], uv=((corners + 1) / 2)[faces])

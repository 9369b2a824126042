"""A box."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from scenetruth.model import Positive
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh

__all__ = ["BoxMesh", "box"]


class BoxMesh(MeshModel):
    """A box, centred on its origin."""

    kind: Literal["box"]
    """``box``."""
    size_mm: tuple[Positive, Positive, Positive]
    """Edge lengths along X, Y, Z in mm."""

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        return MeshSize(8, 12)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return box(self.size_mm)


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

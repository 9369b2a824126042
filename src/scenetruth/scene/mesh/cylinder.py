"""Round cylinders."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Positive
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.grid import CREASE_DEG, grid_faces, pieces
from scenetruth.scene.mesh.resolution import checked_resolution

__all__ = ["CylinderMesh", "cylinder"]

Floats = NDArray[np.float64]


class CylinderMesh(MeshModel):
    """A round cylinder about the Y axis, centred on its origin."""

    kind: Literal["cylinder"]
    """``cylinder``."""
    radius_mm: Positive
    """Its radius in mm."""
    length_mm: Positive
    """Its length along Y in mm."""
    caps: bool = False
    """Whether discs close its two ends."""
    resolution_mm: Positive = 0.5
    """Longest edge of the triangles around and along it in mm; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius, length = info.data.get("radius_mm"), info.data.get("length_mm")
        if radius is None or length is None:
            return value
        # Along it there is one row of triangles at least.
        return checked_resolution(value, radius, "radius_mm", 2 * 6.3 * radius * max(length, value))

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        around, rows = _pieces(self.radius_mm, self.length_mm, self.resolution_mm)
        caps = 2 if self.caps else 0
        return MeshSize(around * (rows + 1) + caps * (around + 1), 2 * around * rows + caps * around)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return cylinder(self.radius_mm, self.length_mm, self.resolution_mm, self.caps)


def _pieces(radius_mm: float, length_mm: float, resolution_mm: float) -> tuple[int, int]:
    """Return into how many pieces a cylinder is cut around and along."""
    return max(pieces(2 * np.pi * radius_mm, resolution_mm), 6), pieces(length_mm, resolution_mm)


def cylinder(radius_mm: float, length_mm: float, resolution_mm: float, caps: bool = False) -> TriangleMesh:
    """Return a round cylinder about the Y axis, its outside outwards.

    The chart unrolls it exactly. An image goes around it once: its middle faces -Z, its sides meet at +Z; on each cap
    it covers the square around the disc.
    """
    around, rows = _pieces(radius_mm, length_mm, resolution_mm)
    turn = np.linspace(-np.pi, np.pi, around + 1)
    angle, height = (part.ravel() for part in np.meshgrid(turn, np.linspace(-0.5, 0.5, rows + 1) * length_mm))
    grid = grid_faces(around, rows)
    # The last column is the first one again, but for its texture coordinates.
    index = np.arange(len(angle)).reshape(rows + 1, around + 1)
    index[:, -1] = index[:, 0]
    kept, faces = np.unique(index.ravel()[grid], return_inverse=True)
    normals = np.column_stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)])[kept]
    vertices = normals * radius_mm + np.column_stack([np.zeros(len(kept)), height[kept], np.zeros(len(kept))])
    zero = np.zeros_like(normals)
    tangents = np.column_stack([-normals[:, 2], zero[:, 0], normals[:, 0]])
    # Down x around points outwards, as the faces do.
    along = np.stack([np.broadcast_to([0.0, 1.0, 0.0], normals.shape), tangents, zero, zero, -normals / radius_mm])
    chart = np.column_stack([radius_mm * angle, height])[grid]
    uv = np.column_stack([angle / (2 * np.pi) + 0.5, height / length_mm + 0.5])[grid]
    parts = [(vertices, faces.reshape(grid.shape), chart, uv, along)]
    for number, sign in enumerate((-1, 1) if caps else ()):
        middle = np.array([radius_mm * (np.pi + 1 + 2 * number), 0.0])
        parts.append(_disc(vertices[vertices[:, 1] == sign * length_mm / 2], radius_mm, sign, middle))
    offsets = np.cumsum([0, *(len(part[0]) for part in parts)])
    return TriangleMesh(
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] + offset for part, offset in zip(parts, offsets, strict=False)]).astype(np.int32),
        chart_mm=np.concatenate([part[2] for part in parts]),
        uv=np.concatenate([part[3] for part in parts]),
        crease_deg=CREASE_DEG,
        along=np.concatenate([part[4] for part in parts], axis=1),
    )


def _disc(
    rim: Floats, radius_mm: float, sign: int, middle: Floats
) -> tuple[Floats, NDArray[np.int64], Floats, Floats, Floats]:
    """Return the flat cap of a cylinder at Y = sign length / 2: vertices, faces, chart, uv and derivatives."""
    count = len(rim)
    vertices = np.concatenate([rim, [[0.0, rim[0, 1], 0.0]]])
    around, following = np.arange(count), (np.arange(count) + 1) % count
    # The rim runs around from +Z by -X and -Z to +X.
    order = (around, following) if sign < 0 else (following, around)
    faces = np.column_stack([*order, np.full(count, count)])
    flat = vertices[:, [0, 2]] * (1, sign)
    along = np.zeros((5, count + 1, 3))
    along[0, :, 2], along[1, :, 0] = sign, 1.0
    return vertices, faces, (flat + middle)[faces], (flat / (2 * radius_mm) + 0.5)[faces], along

"""Rings with a round section."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Positive
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.grid import CREASE_DEG, grid_faces, pieces
from scenetruth.scene.mesh.resolution import checked_resolution

__all__ = ["TorusMesh", "torus"]

_FEWEST = 6  # pieces of a circle


class TorusMesh(MeshModel):
    """A torus about the Z axis: a ring that faces the camera, centred on its origin."""

    kind: Literal["torus"]
    """``torus``."""
    ring_radius_mm: Positive
    """Radius of the circle in the middle of the tube in mm."""
    tube_radius_mm: Positive
    """Radius of the tube in mm, less than that of the ring."""
    resolution_mm: Positive = 0.5
    """Longest edge of the triangles around the tube and, on its outside, around the ring in mm; at most
    tube_radius_mm."""

    @field_validator("tube_radius_mm")
    @classmethod
    def _leaves_a_hole(cls, value: float, info: ValidationInfo) -> float:
        ring = info.data.get("ring_radius_mm")
        if ring is not None and value >= ring:
            msg = f"must be less than ring_radius_mm, {ring:g} mm: the tube would meet itself"
            raise ValueError(msg)
        return value

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        ring, tube = info.data.get("ring_radius_mm"), info.data.get("tube_radius_mm")
        if ring is None or tube is None:
            return value
        return checked_resolution(value, tube, "tube_radius_mm", 2 * (2 * np.pi) ** 2 * (ring + tube) * tube)

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        around, rows = _pieces(self.ring_radius_mm, self.tube_radius_mm, self.resolution_mm)
        return MeshSize(around * rows, 2 * around * rows)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return torus(self.ring_radius_mm, self.tube_radius_mm, self.resolution_mm)


def _pieces(ring_radius_mm: float, tube_radius_mm: float, resolution_mm: float) -> tuple[int, int]:
    """Return into how many pieces a torus is cut around the ring and around the tube."""
    lengths = (2 * np.pi * (ring_radius_mm + tube_radius_mm), 2 * np.pi * tube_radius_mm)
    around, rows = (max(pieces(length, resolution_mm), _FEWEST) for length in lengths)
    return around, rows


def torus(ring_radius_mm: float, tube_radius_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return a torus about the Z axis, its outside outwards.

    At the angle φ around the ring, from X towards Y, and θ around the tube, from the outside towards -Z, a point is
    ((R + r cos θ) cos φ, (R + r cos θ) sin φ, -r sin θ). The chart is (R φ, r θ): exact around the tube, and around the
    ring true to r / R. An image goes around both once: the middle of its height faces -Z, its sides meet at -X, its
    upper and lower edges at +Z.
    """
    around, rows = _pieces(ring_radius_mm, tube_radius_mm, resolution_mm)
    phi, theta = (
        part.ravel()
        for part in np.meshgrid(
            np.linspace(-np.pi, np.pi, around + 1), np.pi / 2 + np.linspace(-np.pi, np.pi, rows + 1)
        )
    )
    grid = grid_faces(around, rows)
    # The last column and the last row are the first ones again, but for their texture coordinates.
    index = np.arange(len(phi)).reshape(rows + 1, around + 1)
    index[:, -1], index[-1] = index[:, 0], index[0]
    index[-1, -1] = 0
    kept, faces = np.unique(index.ravel()[grid], return_inverse=True)

    zero, one = np.zeros(len(kept)), np.ones(len(kept))
    outward = np.column_stack([np.cos(phi[kept]), np.sin(phi[kept]), zero])
    ahead = np.column_stack([-outward[:, 1], outward[:, 0], zero])
    axis = np.column_stack([zero, zero, one])
    sine, cosine = np.sin(theta[kept])[:, None], np.cos(theta[kept])[:, None]
    share = 1 + tube_radius_mm / ring_radius_mm * cosine
    # By r θ and R φ: these directions, one x the other, point outwards, as the faces do.
    along = np.stack(
        [
            -sine * outward - cosine * axis,
            share * ahead,
            (sine * axis - cosine * outward) / tube_radius_mm,
            -sine / ring_radius_mm * ahead,
            -share / ring_radius_mm * outward,
        ]
    )
    return TriangleMesh(
        ring_radius_mm * share * outward - tube_radius_mm * sine * axis,
        faces.reshape(grid.shape).astype(np.int32),
        chart_mm=np.column_stack([ring_radius_mm * phi, tube_radius_mm * theta])[grid],
        uv=np.column_stack([phi / (2 * np.pi) + 0.5, (theta - np.pi / 2) / (2 * np.pi) + 0.5])[grid],
        crease_deg=CREASE_DEG,
        along=along,
    )

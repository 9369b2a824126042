"""Spheres and their caps."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from scenetruth.model import Positive
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.grid import CREASE_DEG, disc_faces, grid_faces, pieces
from scenetruth.scene.mesh.resolution import checked_resolution

__all__ = ["SphereMesh", "sphere", "spherical_cap"]

Floats = NDArray[np.float64]

# Right and down as seen from outside, for the six sides of a cube; the outward normal is down x right.
_CUBE_SIDES = (
    ((1, 0, 0), (0, 1, 0)),
    ((0, 0, 1), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0)),
    ((0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 0, 1)),
)


class SphereMesh(MeshModel):
    """A sphere about its origin, or the cap of it that faces the camera (about -Z)."""

    kind: Literal["sphere"]
    """``sphere``."""
    radius_mm: Positive
    """Its radius in mm."""
    cap_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """Angle from its middle to its rim as seen from the centre, at most 90; null for the full sphere."""
    resolution_mm: Positive = 0.5
    """Length of the triangles' edges in mm, about; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius = info.data.get("radius_mm")
        return value if radius is None else checked_resolution(value, radius, "radius_mm", 8 * 3.2 * radius**2)

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        if self.cap_deg is not None:
            rings = _rings(self.radius_mm, self.cap_deg, self.resolution_mm)
            return MeshSize(3 * rings * (rings + 1) + 1, 6 * rings**2)
        count = _pieces_of_a_side(self.radius_mm, self.resolution_mm)
        return MeshSize(6 * count**2 + 2, 12 * count**2)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        if self.cap_deg is not None:
            return spherical_cap(self.radius_mm, self.cap_deg, self.resolution_mm)
        return sphere(self.radius_mm, self.resolution_mm)


def _pieces_of_a_side(radius_mm: float, resolution_mm: float) -> int:
    """Return into how many pieces the sides of the cube are cut that a sphere is made from."""
    # An even number: the poles, and the meridian where the image's sides meet, run along edges of triangles.
    return 2 * ceil(np.pi * radius_mm / 4 / resolution_mm - 1e-9)


def _rings(radius_mm: float, cap_deg: float, resolution_mm: float) -> int:
    """Return how many rings of triangles a cap has."""
    return pieces(radius_mm * float(np.deg2rad(cap_deg)), resolution_mm)


def sphere(radius_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return a sphere, made from the six sides of a cube by equal angles.

    Each side has a place of its own in the chart, by Lambert's projection about its middle: areas are kept, lengths to
    13 % at its corners and to 8 % at the middles of its edges, where the patterns of neighbouring sides meet. An image
    is laid on by longitude and latitude: its middle faces -Z, its upper edge is the pole at -Y, its sides meet at +Z.
    """
    count = _pieces_of_a_side(radius_mm, resolution_mm)
    angle = np.tan(np.linspace(-np.pi / 4, np.pi / 4, count + 1))
    # Exactly the diagonals of the cube's sides.
    angle[0], angle[count // 2], angle[-1] = -1, 0, 1
    right_part, down_part = (part.ravel() for part in np.meshgrid(angle, angle))
    grid = grid_faces(count, count)
    directions, faces, chart = [], [], []
    # A side reaches 2 sin(22.5°) = 0.77 radii to the middles of its edges.
    cell = 1.6 * radius_mm
    for number, (right, down) in enumerate(np.asarray(_CUBE_SIDES, dtype=np.float64)):
        normal = np.cross(down, right)
        side = normal + right_part[:, None] * right + down_part[:, None] * down
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        place = np.array([number % 3, number // 3]) * cell
        flat = _lambert(side @ right, side @ down, side @ normal, radius_mm) + place
        directions.append(side)
        faces.append(grid + number * len(side))
        chart.append(flat[grid])
    stacked = np.concatenate(directions)
    _, first, welded = np.unique(stacked.round(9) + 0.0, axis=0, return_index=True, return_inverse=True)
    corners = welded.reshape(-1)[np.concatenate(faces)].astype(np.int32)
    normals = stacked[first]
    return TriangleMesh(
        normals * radius_mm,
        corners,
        chart_mm=np.concatenate(chart),
        uv=_longitude_latitude(normals, corners),
        crease_deg=CREASE_DEG,
        along=_along_sphere(normals, radius_mm),
    )


def spherical_cap(radius_mm: float, cap_deg: float, resolution_mm: float) -> TriangleMesh:
    """Return the part of a sphere about its origin that is at most ``cap_deg`` away from -Z.

    Texture coordinates are Lambert's projection about its middle: areas are kept, lengths to a factor of
    cos(cap_deg / 2) at its rim. An image covers the square around it.
    """
    reach = np.deg2rad(cap_deg)
    rings = _rings(radius_mm, cap_deg, resolution_mm)
    counts = [1, *(6 * ring for ring in range(1, rings + 1))]
    polar = np.repeat(np.arange(rings + 1) * (reach / rings), counts)
    turn = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts])
    normals = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)])
    faces = disc_faces(rings)
    chart = _lambert(normals[:, 0], normals[:, 1], -normals[:, 2], radius_mm)
    return TriangleMesh(
        normals * radius_mm,
        faces,
        chart_mm=chart[faces],
        uv=(chart / (4 * radius_mm * np.sin(reach / 2)) + 0.5)[faces],
        crease_deg=CREASE_DEG,
        along=_along_sphere(normals, radius_mm),
    )


def _lambert(right: Floats, down: Floats, up: Floats, radius_mm: float) -> Floats:
    """Project directions of a sphere by Lambert's equal-area projection about the direction ``up``."""
    scale = radius_mm * np.sqrt(2 / (1 + up))
    return np.column_stack([right * scale, down * scale])


def _along_sphere(normals: Floats, radius_mm: float) -> Floats:
    """Return the derivatives along two orthonormal tangents of a sphere, one x two = outward normal."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    one = np.cross(axis, normals)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    bend = -normals / radius_mm
    return np.stack([one, np.cross(normals, one), bend, np.zeros_like(bend), bend])


def _longitude_latitude(normals: Floats, faces: NDArray[np.int32]) -> Floats:
    """Return u by longitude and v by latitude at the corners of triangles that do not cross the meridian +Z."""
    corners = normals[faces]
    longitude = np.arctan2(corners[..., 0], -corners[..., 2])
    middle = corners.mean(axis=1)
    about = np.arctan2(middle[:, 0], -middle[:, 2])[:, None]
    longitude += 2 * np.pi * np.rint((about - longitude) / (2 * np.pi))
    # A pole has every longitude.
    pole = np.hypot(corners[..., 0], corners[..., 2]) < 1e-9
    others = np.where(pole, 0, longitude).sum(axis=1, keepdims=True) / 2
    longitude = np.where(pole, others, longitude)
    latitude = np.arcsin(np.clip(corners[..., 1], -1, 1))
    return np.stack([longitude / (2 * np.pi) + 0.5, latitude / np.pi + 0.5], axis=-1)

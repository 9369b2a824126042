"""Geometric bodies: boxes, cylinders, spheres and spherical caps, stairs and tori."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from scenetruth.scene.mesh.mesh_model import (
    CREASE_DEG,
    MeshModel,
    MeshSize,
    TriangleMesh,
    check_resolution,
    count_pieces,
    make_disc_faces,
    make_grid_faces,
)
from scenetruth.validated_model import Finite, Positive

__all__ = [
    "BoxMesh",
    "CylinderMesh",
    "SphereMesh",
    "StairsMesh",
    "TorusMesh",
    "make_box",
    "make_cylinder",
    "make_sphere",
    "make_spherical_cap",
    "make_stairs",
    "make_torus",
]


class BoxMesh(MeshModel):
    """Box centred on the origin."""

    kind: Literal["box"]
    """``box``."""
    size_mm: tuple[Positive, Positive, Positive]
    """Edge lengths along X, Y, Z in mm."""

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        return MeshSize(8, 12)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_box(self.size_mm)


def make_box(size_mm: tuple[float, float, float]) -> TriangleMesh:
    """Return a box centred on the origin; each side has a separate chart region and shows a complete image."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
    vertices = signs * (np.asarray(size_mm) / 2)
    # Corners of each side, clockwise from the upper left as seen from outside.
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


Floats = NDArray[np.float64]


class CylinderMesh(MeshModel):
    """Circular cylinder about the Y axis, centred on the origin."""

    kind: Literal["cylinder"]
    """``cylinder``."""
    radius_mm: Positive
    """Radius in mm."""
    length_mm: Positive
    """Length along Y in mm."""
    caps: bool = False
    """Whether discs close both ends."""
    resolution_mm: Positive = 0.5
    """Longest triangle edge around and along the cylinder in mm; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius, length = info.data.get("radius_mm"), info.data.get("length_mm")
        if radius is None or length is None:
            return value
        # At least one row of triangles along the axis.
        return check_resolution(value, radius, "radius_mm", 2 * 6.3 * radius * max(length, value))

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        around, rows = _count_cylinder_pieces(self.radius_mm, self.length_mm, self.resolution_mm)
        caps = 2 if self.caps else 0
        return MeshSize(around * (rows + 1) + caps * (around + 1), 2 * around * rows + caps * around)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_cylinder(self.radius_mm, self.length_mm, self.resolution_mm, self.caps)


def _count_cylinder_pieces(radius_mm: float, length_mm: float, resolution_mm: float) -> tuple[int, int]:
    """Return the number of pieces around and along a cylinder."""
    return max(count_pieces(2 * np.pi * radius_mm, resolution_mm), 6), count_pieces(length_mm, resolution_mm)


def make_cylinder(radius_mm: float, length_mm: float, resolution_mm: float, caps: bool = False) -> TriangleMesh:
    """Return a circular cylinder about the Y axis, facing outwards.

    The chart is its exact development. An image covers the circumference once: its centre faces -Z, its sides meet at
    +Z; on each cap it covers the bounding square of the disc.
    """
    around, rows = _count_cylinder_pieces(radius_mm, length_mm, resolution_mm)
    turn = np.linspace(-np.pi, np.pi, around + 1)
    angle, height = (part.ravel() for part in np.meshgrid(turn, np.linspace(-0.5, 0.5, rows + 1) * length_mm))
    grid = make_grid_faces(around, rows)
    # The last column duplicates the first, except for its texture coordinates.
    index = np.arange(len(angle)).reshape(rows + 1, around + 1)
    index[:, -1] = index[:, 0]
    kept, faces = np.unique(index.ravel()[grid], return_inverse=True)
    normals = np.column_stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)])[kept]
    vertices = normals * radius_mm + np.column_stack([np.zeros(len(kept)), height[kept], np.zeros(len(kept))])
    zero = np.zeros_like(normals)
    tangents = np.column_stack([-normals[:, 2], zero[:, 0], normals[:, 0]])
    # Down x around points outwards, as do the faces.
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
    # The rim runs from +Z via -X and -Z to +X.
    order = (around, following) if sign < 0 else (following, around)
    faces = np.column_stack([*order, np.full(count, count)])
    flat = vertices[:, [0, 2]] * (1, sign)
    along = np.zeros((5, count + 1, 3))
    along[0, :, 2], along[1, :, 0] = sign, 1.0
    return vertices, faces, (flat + middle)[faces], (flat / (2 * radius_mm) + 0.5)[faces], along


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
    """Sphere about the origin, or its cap that faces the camera (about -Z)."""

    kind: Literal["sphere"]
    """``sphere``."""
    radius_mm: Positive
    """Radius in mm."""
    cap_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """Half the opening angle of the cap as seen from the centre, at most 90; null for the full sphere."""
    resolution_mm: Positive = 0.5
    """Approximate edge length of the triangles in mm; at most the radius."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        radius = info.data.get("radius_mm")
        return value if radius is None else check_resolution(value, radius, "radius_mm", 8 * 3.2 * radius**2)

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        if self.cap_deg is not None:
            rings = _rings(self.radius_mm, self.cap_deg, self.resolution_mm)
            return MeshSize(3 * rings * (rings + 1) + 1, 6 * rings**2)
        count = _pieces_of_a_side(self.radius_mm, self.resolution_mm)
        return MeshSize(6 * count**2 + 2, 12 * count**2)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        if self.cap_deg is not None:
            return make_spherical_cap(self.radius_mm, self.cap_deg, self.resolution_mm)
        return make_sphere(self.radius_mm, self.resolution_mm)


def _pieces_of_a_side(radius_mm: float, resolution_mm: float) -> int:
    """Return the number of pieces per side of the cube that defines the sphere mesh."""
    # An even number, so that the poles and the image seam coincide with triangle edges.
    return 2 * ceil(np.pi * radius_mm / 4 / resolution_mm - 1e-9)


def _rings(radius_mm: float, cap_deg: float, resolution_mm: float) -> int:
    """Return the number of triangle rings of a cap."""
    return count_pieces(radius_mm * float(np.deg2rad(cap_deg)), resolution_mm)


def make_sphere(radius_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return a sphere, subdivided from the six sides of a cube by equal angles.

    Each side has a separate chart region, by Lambert's equal-area projection about its centre: lengths are accurate to
    13 % at the corners and to 8 % at the edge midpoints, where the patterns of neighbouring sides meet. An image is
    mapped by longitude and latitude: its centre faces -Z, its upper edge is the pole at -Y, its sides meet at +Z.
    """
    count = _pieces_of_a_side(radius_mm, resolution_mm)
    angle = np.tan(np.linspace(-np.pi / 4, np.pi / 4, count + 1))
    # Exact values at the diagonals of the cube sides.
    angle[0], angle[count // 2], angle[-1] = -1, 0, 1
    right_part, down_part = (part.ravel() for part in np.meshgrid(angle, angle))
    grid = make_grid_faces(count, count)
    directions, faces, chart = [], [], []
    # A side extends 2 sin(22.5°) = 0.77 radii to its edge midpoints.
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


def make_spherical_cap(radius_mm: float, cap_deg: float, resolution_mm: float) -> TriangleMesh:
    """Return the part of a sphere about the origin within ``cap_deg`` of -Z.

    Texture coordinates are Lambert's equal-area projection about its centre: lengths are accurate to a factor of
    cos(cap_deg / 2) at the rim. An image covers the bounding square.
    """
    reach = np.deg2rad(cap_deg)
    rings = _rings(radius_mm, cap_deg, resolution_mm)
    counts = [1, *(6 * ring for ring in range(1, rings + 1))]
    polar = np.repeat(np.arange(rings + 1) * (reach / rings), counts)
    turn = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts])
    normals = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)])
    faces = make_disc_faces(rings)
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
    """Project directions by Lambert's equal-area projection about the direction ``up``."""
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
    # Longitude is undefined at a pole.
    pole = np.hypot(corners[..., 0], corners[..., 2]) < 1e-9
    others = np.where(pole, 0, longitude).sum(axis=1, keepdims=True) / 2
    longitude = np.where(pole, others, longitude)
    latitude = np.arcsin(np.clip(corners[..., 1], -1, 1))
    return np.stack([longitude / (2 * np.pi) + 0.5, latitude / np.pi + 0.5], axis=-1)


class StairsMesh(MeshModel):
    """Stairs in depth: treads side by side along X, facing the camera (normal -Z).

    The origin is at the centre of width and height, halfway between the nearest and farthest tread.
    """

    kind: Literal["stairs"]
    """``stairs``."""
    tread_mm: tuple[Positive, Positive]
    """Size of each tread along X and Y in mm."""
    steps_mm: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=10_000)]
    """Depth of each tread relative to its left neighbour, in mm; one value fewer than treads."""
    risers: bool = True
    """Whether risers connect the treads."""

    @field_validator("steps_mm")
    @classmethod
    def _real_steps(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        flat = [str(index) for index, step in enumerate(value) if step == 0]
        if flat:
            msg = f"steps must not be 0 (got 0 at index {', '.join(flat)}): merge the treads"
            raise ValueError(msg)
        return value

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_stairs(self.tread_mm, self.steps_mm, self.risers)


def make_stairs(tread_mm: tuple[float, float], steps_mm: Sequence[float], risers: bool = True) -> TriangleMesh:
    """Return treads along X facing -Z with depth increments ``steps_mm``; the chart develops them in order."""
    width, height = tread_mm
    depth = np.concatenate([[0.0], np.cumsum(steps_mm)])
    depth -= (depth.min() + depth.max()) / 2
    left = (np.arange(len(depth)) - len(depth) / 2) * width
    # Profile: both ends of every tread.
    ends = np.column_stack([left, depth, left + width, depth]).reshape(-1, 2)
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    if not risers:
        run = np.repeat(np.arange(len(depth)) * width, 2) + np.tile([0.0, width], len(depth))
    count = len(ends)
    pieces = np.arange(count - 1) if risers else np.arange(0, count - 1, 2)
    quads = np.column_stack([pieces, pieces + count, pieces + 1 + count, pieces + 1])
    faces = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).astype(np.int32)
    x, z = np.tile(ends.T, 2)
    y = np.repeat([-height / 2, height / 2], count)
    chart = np.column_stack([np.tile(run, 2), y])
    uv = chart / (run[-1], height) + (0, 0.5)
    return TriangleMesh(np.column_stack([x, y, z]), faces, chart_mm=chart[faces], uv=uv[faces])


_FEWEST = 6  # minimum number of pieces of a circle


class TorusMesh(MeshModel):
    """Torus about the Z axis: a ring facing the camera, centred on the origin."""

    kind: Literal["torus"]
    """``torus``."""
    ring_radius_mm: Positive
    """Radius of the tube's centre circle in mm."""
    tube_radius_mm: Positive
    """Radius of the tube in mm, smaller than that of the ring."""
    resolution_mm: Positive = 0.5
    """Longest triangle edge around the tube and along the outer circumference in mm; at most tube_radius_mm."""

    @field_validator("tube_radius_mm")
    @classmethod
    def _leaves_a_hole(cls, value: float, info: ValidationInfo) -> float:
        ring = info.data.get("ring_radius_mm")
        if ring is not None and value >= ring:
            msg = f"must be less than ring_radius_mm, {ring:g} mm: the tube would intersect itself"
            raise ValueError(msg)
        return value

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        ring, tube = info.data.get("ring_radius_mm"), info.data.get("tube_radius_mm")
        if ring is None or tube is None:
            return value
        return check_resolution(value, tube, "tube_radius_mm", 2 * (2 * np.pi) ** 2 * (ring + tube) * tube)

    def size(self, folder: Path) -> MeshSize:
        """Return the mesh size, see `MeshModel`."""
        around, rows = _count_torus_pieces(self.ring_radius_mm, self.tube_radius_mm, self.resolution_mm)
        return MeshSize(around * rows, 2 * around * rows)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh, see `MeshModel`."""
        return make_torus(self.ring_radius_mm, self.tube_radius_mm, self.resolution_mm)


def _count_torus_pieces(ring_radius_mm: float, tube_radius_mm: float, resolution_mm: float) -> tuple[int, int]:
    """Return the number of pieces around the ring and around the tube."""
    lengths = (2 * np.pi * (ring_radius_mm + tube_radius_mm), 2 * np.pi * tube_radius_mm)
    around, rows = (max(count_pieces(length, resolution_mm), _FEWEST) for length in lengths)
    return around, rows


def make_torus(ring_radius_mm: float, tube_radius_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return a torus about the Z axis, facing outwards.

    At the angle φ around the ring, from X towards Y, and θ around the tube, from the outside towards -Z, a point is ((R
    + r cos θ) cos φ, (R + r cos θ) sin φ, -r sin θ). The chart is (R φ, r θ): exact around the tube, and accurate to r
    / R around the ring. An image covers both circumferences once: its horizontal centre line faces -Z, its sides meet
    at -X, its upper and lower edges at +Z.
    """
    around, rows = _count_torus_pieces(ring_radius_mm, tube_radius_mm, resolution_mm)
    phi, theta = (
        part.ravel()
        for part in np.meshgrid(
            np.linspace(-np.pi, np.pi, around + 1), np.pi / 2 + np.linspace(-np.pi, np.pi, rows + 1)
        )
    )
    grid = make_grid_faces(around, rows)
    # The last column and row duplicate the first, except for their texture coordinates.
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
    # Derivatives by r θ and R φ; their cross product points outwards, as do the faces.
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

"""Meshes of surfaces that follow a formula: every vertex lies on the smooth surface, which they tell exactly."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.jets import Field
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.motion import PointMap, Points

__all__ = ["cylinder", "relief", "saddle", "sheet", "sphere", "spherical_cap", "stairs"]

Floats = NDArray[np.float64]

# Facets of a smooth surface meet at less, sides of a body at more.
_CREASE_DEG = 60.0
# Right and down as seen from outside, for the six sides of a cube; the outward normal is down x right.
_CUBE_SIDES = (
    ((1, 0, 0), (0, 1, 0)),
    ((0, 0, 1), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0)),
    ((0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 0, 1)),
)


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
    columns, rows = (_pieces(length, resolution_mm) for length in size_mm)
    across, down = (np.linspace(-0.5, 0.5, count + 1) for count in (columns, rows))
    unit = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    material = unit * size_mm
    points: Points = (*np.ascontiguousarray(material.T), np.zeros(len(material)))
    if shape is not None:
        points = shape(points, np.zeros(1))
    vertices = np.column_stack(np.broadcast_arrays(*points))
    faces = _grid_faces(columns, rows)
    return TriangleMesh(
        vertices,
        faces,
        chart_mm=material[faces],
        uv=(unit + 0.5)[faces],
        crease_deg=_CREASE_DEG,
        material_mm=material,
        shape=shape,
    )


def saddle(size_mm: tuple[float, float], curvature_per_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return the saddle Z = curvature (X² - Y²) / 2 over a rectangle."""

    def shape(points: Points, t: Field) -> Points:
        x, y, z = points
        return x, y, z + curvature_per_mm / 2 * (x * x - y * y)

    return sheet(size_mm, resolution_mm, shape)


def relief(
    size_mm: tuple[float, float],
    amplitude_mm: float,
    wavelength_mm: tuple[float | None, float | None],
    phase_deg: tuple[float, float],
    resolution_mm: float,
) -> TriangleMesh:
    """Return the waves Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y); λ of None means a constant."""
    rates = [0.0 if length is None else 2 * np.pi / length for length in wavelength_mm]
    phases = np.deg2rad(phase_deg)

    def shape(points: Points, t: Field) -> Points:
        x, y, z = points
        return x, y, z - amplitude_mm * np.cos(rates[0] * x + phases[0]) * np.cos(rates[1] * y + phases[1])

    return sheet(size_mm, resolution_mm, shape)


def sphere(radius_mm: float, resolution_mm: float) -> TriangleMesh:
    """Return a sphere, made from the six sides of a cube by equal angles.

    Each side has a place of its own in the chart, by Lambert's projection about its middle: areas are kept, lengths to
    13 % at its corners and to 8 % at the middles of its edges, where the patterns of neighbouring sides meet. An image
    is laid on by longitude and latitude: its middle faces -Z, its upper edge is the pole at -Y, its sides meet at +Z.
    """
    # An even number: the poles, and the meridian where the image's sides meet, run along edges of triangles.
    count = 2 * ceil(np.pi * radius_mm / 4 / resolution_mm - 1e-9)
    angle = np.tan(np.linspace(-np.pi / 4, np.pi / 4, count + 1))
    # Exactly the diagonals of the cube's sides.
    angle[0], angle[count // 2], angle[-1] = -1, 0, 1
    right_part, down_part = (part.ravel() for part in np.meshgrid(angle, angle))
    grid = _grid_faces(count, count)
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
        crease_deg=_CREASE_DEG,
        along=_along_sphere(normals, radius_mm),
    )


def spherical_cap(radius_mm: float, cap_deg: float, resolution_mm: float) -> TriangleMesh:
    """Return the part of a sphere about its origin that is at most ``cap_deg`` away from -Z.

    Texture coordinates are Lambert's projection about its middle: areas are kept, lengths to a factor of
    cos(cap_deg / 2) at its rim. An image covers the square around it.
    """
    reach = np.deg2rad(cap_deg)
    rings = _pieces(radius_mm * reach, resolution_mm)
    counts = [1, *(6 * ring for ring in range(1, rings + 1))]
    polar = np.repeat(np.arange(rings + 1) * (reach / rings), counts)
    turn = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts])
    normals = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)])
    faces = _disc_faces(rings)
    chart = _lambert(normals[:, 0], normals[:, 1], -normals[:, 2], radius_mm)
    return TriangleMesh(
        normals * radius_mm,
        faces,
        chart_mm=chart[faces],
        uv=(chart / (4 * radius_mm * np.sin(reach / 2)) + 0.5)[faces],
        crease_deg=_CREASE_DEG,
        along=_along_sphere(normals, radius_mm),
    )


def cylinder(radius_mm: float, length_mm: float, resolution_mm: float, caps: bool = False) -> TriangleMesh:
    """Return a round cylinder about the Y axis, its outside outwards.

    The chart unrolls it exactly. An image goes around it once: its middle faces -Z, its sides meet at +Z; on each cap
    it covers the square around the disc.
    """
    around, rows = max(_pieces(2 * np.pi * radius_mm, resolution_mm), 6), _pieces(length_mm, resolution_mm)
    turn = np.linspace(-np.pi, np.pi, around + 1)
    angle, height = (part.ravel() for part in np.meshgrid(turn, np.linspace(-0.5, 0.5, rows + 1) * length_mm))
    grid = _grid_faces(around, rows)
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
        crease_deg=_CREASE_DEG,
        along=np.concatenate([part[4] for part in parts], axis=1),
    )


def stairs(tread_mm: tuple[float, float], steps_mm: Sequence[float], risers: bool = True) -> TriangleMesh:
    """Return treads side by side along X that face -Z, each farther than its left neighbour by one of ``steps_mm``.

    The chart unrolls them, risers included, from left to right; an image covers all of it.
    """
    width, height = tread_mm
    depth = np.concatenate([[0.0], np.cumsum(steps_mm)])
    depth -= (depth.min() + depth.max()) / 2
    left = (np.arange(len(depth)) - len(depth) / 2) * width
    # The profile: both ends of every tread.
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


def _pieces(length: float, longest: float) -> int:
    # A length that is a multiple, but for rounding, is not cut once more.
    return max(ceil(length / longest - 1e-9), 1)


def _grid_faces(columns: int, rows: int) -> NDArray[np.int32]:
    """Return two triangles for each cell of a grid of (rows + 1) x (columns + 1) vertices."""
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    down, right = first + columns + 1, first + 1
    both = down + 1
    faces = np.stack([np.column_stack([first, down, both]), np.column_stack([first, both, right])], axis=1)
    return faces.reshape(-1, 3).astype(np.int32)


def _disc_faces(rings: int) -> NDArray[np.int32]:
    """Return the triangles of rings of 6, 12, 18, ... vertices around a middle; down x right points to the viewer."""
    faces = []
    for ring in range(1, rings + 1):
        outer_start = 3 * ring * (ring - 1) + 1
        inner_start = 0 if ring == 1 else outer_start - 6 * (ring - 1)
        inner_count, outer_count = max(6 * (ring - 1), 1), 6 * ring
        sector, step = np.divmod(np.arange(outer_count), ring)
        inner = sector * (ring - 1) + step
        outer = np.arange(outer_count)
        here, after = inner_start + inner % inner_count, inner_start + (inner + 1) % inner_count
        one, two = outer_start + outer, outer_start + (outer + 1) % outer_count
        faces.append(np.column_stack([here, two, one]))
        between = step < ring - 1
        faces.append(np.column_stack([here, after, two])[between])
    return np.concatenate(faces).astype(np.int32)


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

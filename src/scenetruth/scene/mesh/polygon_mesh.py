"""Polygons of a mesh file, and their triangles, held against the area of the polygons."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["FileGloss", "FileMaterial", "MeshFileError", "PolygonMesh", "TextureMap", "Triangulation", "triangulate"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAME_AREA = 1e-6  # largest difference between the areas of a polygon and its triangles, relative to its perimeter²
_LEAST_CORNERS = 3
_NO_AREA = 1e-14  # area of a polygon without area, relative to its perimeter²


class MeshFileError(ValueError):
    """Content of a mesh file that cannot be read, or not without doubt."""


@dataclass(frozen=True)
class TextureMap:
    """A picture on a surface."""

    file: Path | None = None
    """File of the picture; None if it is embedded."""
    content: bytes | None = None
    """The embedded file."""
    transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    """Rows of the matrix that maps (u, v, 1), with v upwards, to the coordinates in the picture."""
    wrap: tuple[str, str] = ("repeat", "repeat")
    """Continuation beyond the picture along u and v: ``repeat``, ``mirror`` or ``clamp``."""
    nearest: bool = False
    """Whether texels are sampled without interpolation."""


class FileGloss(NamedTuple):
    """Reflection of a material beyond its diffuse colour; the terms are those of `scene.material.Material`."""

    refractive_index: float
    roughness: float
    metallic: float
    reflectance: float
    transmittance: float


@dataclass(frozen=True)
class FileMaterial:
    """Diffuse reflectance of the faces of a material."""

    name: str
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear factor of red, green and blue."""
    picture: TextureMap | None = None
    alpha_cutoff: float | None = None
    """Opacity of the picture below which the surface is cut out; None for an opaque surface."""
    problem: str | None = None
    """Why the material cannot be shown; matters only if the scene asks for the colours of the file."""
    outline_problem: str | None = None
    """Why the outline of the surface is undefined, if the picture has a transparent texel or there is no picture."""
    gloss: FileGloss | None = None
    """Gloss and transmission, for scenes that ask for them; None if the file gives none."""
    gloss_problem: str | None = None
    """Why gloss and transmission cannot be shown; matters only if the scene asks for them."""


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """Polygons as the file has them.

    ``vertices``: Positions in units of the file, shape (n, 3).
    ``corners``: Vertex of every corner, polygon after polygon, shape (k,).
    ``starts``: First corner of every polygon, and k, shape (m + 1,).
    ``uv``: Texture coordinates of the corners with v upwards, shape (k, 2), NaN where missing; None without.
    ``normals``: Normals of the corners, of any length, shape (k, 3), NaN where missing; None without.
    ``colours``: Linear colours of the corners in [0, 1], shape (k, 3); None without.
    ``material_of``: FileMaterial of every polygon, -1 for none, shape (m,).
    ``ignored``: Content of the file that is not used, for people.
    """

    vertices: Floats
    corners: Indices
    starts: Indices
    uv: Floats | None = None
    normals: Floats | None = None
    colours: Floats | None = None
    materials: tuple[FileMaterial, ...] = ()
    material_of: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    ignored: tuple[str, ...] = ()

    @property
    def counts(self) -> Indices:
        """Numbers of corners of the polygons."""
        return np.diff(self.starts)

    def without_repeated_corners(self) -> PolygonMesh:
        """Return the polygons without corners at the place of the next corner, which enclose nothing.

        Polygons that would have fewer than three corners remain as they are.
        """
        if len(self.starts) < 2:
            return self
        after = np.arange(len(self.corners)) + 1
        after[self.starts[1:] - 1] = self.starts[:-1]
        repeated = (self.vertices[self.corners] == self.vertices[self.corners[after]]).all(axis=1)
        left = self.counts - np.add.reduceat(repeated.astype(np.int64), self.starts[:-1])
        repeated &= np.repeat(left >= _LEAST_CORNERS, self.counts)
        if not repeated.any():
            return self
        keep = ~repeated
        counts = np.where(left >= _LEAST_CORNERS, left, self.counts)
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(self.starts.dtype)

        def kept(values: Floats | None) -> Floats | None:
            return None if values is None else values[keep]

        return replace(
            self,
            corners=self.corners[keep],
            starts=starts,
            uv=kept(self.uv),
            normals=kept(self.normals),
            colours=kept(self.colours),
        )

    def area_vectors(self) -> Floats:
        """Return the area times the normal of every polygon (Newell), shape (m, 3)."""
        return newell(self.vertices, self.corners, self.starts)[0]


class Triangulation(NamedTuple):
    """Triangles of polygons."""

    corners: Indices
    """Corners of each triangle, as indices of `PolygonMesh.corners`, shape (t, 3)."""
    polygon: Indices
    """Polygon of each triangle, shape (t,)."""
    empty: int
    """Number of polygons without area, which have no triangles."""
    bent: int
    """Number of polygons that are not plane."""


def newell(vertices: Floats, corners: Indices, starts: Indices) -> tuple[Floats, Floats]:
    """Return half the sum of the cross products of successive corners, shape (m, 3), and of their lengths, shape (m,).

    The first is the area times the normal of a polygon; the second is 0 only if all corners lie on a line.
    """
    if len(starts) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    # Relative to the first corner, so that distant meshes lose no digits.
    counts = np.diff(starts)
    first = np.repeat(corners[starts[:-1]], counts)
    relative = vertices[corners] - vertices[first]
    after = np.arange(len(corners)) + 1
    after[starts[1:] - 1] = starts[:-1]
    parts = 0.5 * np.cross(relative, relative[after])
    lengths = np.linalg.norm(parts, axis=1)
    return np.add.reduceat(parts, starts[:-1], axis=0), np.add.reduceat(lengths, starts[:-1])


def triangulate(mesh: PolygonMesh) -> Triangulation:
    """Divide polygons into triangles that cover each of them exactly once, seen along its normal.

    Concave polygons are cut by ear clipping. Plane quadrilaterals and convex polygons become fans around their first
    corner, which is the usual convention for those that are not plane.

    Raises
    ------
    MeshFileError
        If a polygon intersects itself, so that its triangles have another area.
    """
    area, spread = newell(mesh.vertices, mesh.corners, mesh.starts)
    size = np.linalg.norm(area, axis=1)
    around = _perimeters(mesh)
    present = spread > np.maximum(_NO_AREA * around**2, 1e-300)
    crossed = present & (size <= _SAME_AREA * spread)
    if crossed.any():
        msg = f"face {int(np.argmax(crossed)) + 1} of {len(size)} intersects itself: it encloses no area; divide it"
        raise MeshFileError(msg)
    normal = area / np.where(size > 0, size, 1.0)[:, None]
    counts = mesh.counts
    corners: list[Indices] = []
    owners: list[Indices] = []
    bent = 0
    for count in np.unique(counts[present]):
        polygons = np.flatnonzero(present & (counts == count))
        places = mesh.starts[polygons][:, None] + np.arange(count)
        if count == 3:
            corners.append(places)
            owners.append(polygons)
            continue
        points = mesh.vertices[mesh.corners[places]]
        points = points - points[:, :1]
        height = np.abs(np.einsum("pck,pk->pc", points, normal[polygons])).max(axis=1)
        bent += int(np.count_nonzero(height > 1e-6 * np.sqrt(size[polygons])))
        fan = np.stack([np.zeros(count - 2, dtype=np.int64), np.arange(1, count - 1), np.arange(2, count)], axis=-1)
        signed = _signed_areas(points, fan, normal[polygons])
        convex = (signed >= -_SAME_AREA * size[polygons, None]).all(axis=1)
        corners.append(places[convex][:, fan].reshape(-1, 3))
        owners.append(np.repeat(polygons[convex], len(fan)))
        for n in np.flatnonzero(~convex):
            cut = _clip_ears(points[n], normal[polygons[n]])
            _check_corners(points[n], cut, int(polygons[n]), len(size))
            corners.append(places[n][cut])
            owners.append(np.full(len(cut), polygons[n]))
    if not corners:
        return Triangulation(np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64), len(counts), 0)
    found, owner = np.concatenate(corners), np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    found, owner = found[order], owner[order]
    _check_areas(mesh, found, owner, normal, size, present, around)
    return Triangulation(found, owner, int(np.count_nonzero(~present)), bent)


def _perimeters(mesh: PolygonMesh) -> Floats:
    """Return the lengths of the outlines of all polygons, shape (m,)."""
    if len(mesh.starts) < 2:
        return np.zeros(0)
    after = np.arange(len(mesh.corners)) + 1
    after[mesh.starts[1:] - 1] = mesh.starts[:-1]
    sides = np.linalg.norm(mesh.vertices[mesh.corners[after]] - mesh.vertices[mesh.corners], axis=1)
    return np.asarray(np.add.reduceat(sides, mesh.starts[:-1]))


def _signed_areas(points: Floats, triangles: Indices, normal: Floats) -> Floats:
    """Return the areas of triangles of polygons (p, corners, 3) along their normals, shape (p, t)."""
    a, b, c = (points[:, triangles[:, k]] for k in range(3))
    return np.asarray(0.5 * np.einsum("ptk,pk->pt", np.cross(b - a, c - a), normal))


def _clip_ears(points: Floats, normal: Floats) -> Indices:
    """Return the triangles of a concave polygon, as indices of its corners, with its orientation."""
    import mapbox_earcut

    axis = np.eye(3)[np.argmin(np.abs(normal))]
    across = np.cross(normal, axis)
    across /= np.linalg.norm(across)
    flat = np.column_stack([points @ across, points @ np.cross(normal, across)])
    cut = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32))
    triangles = np.asarray(cut, dtype=np.int64).reshape(-1, 3)
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def _check_corners(points: Floats, cut: Indices, polygon: int, polygons: int) -> None:
    """Raise MeshFileError for corners that are no corner of a triangle, unless they lie on a side of the polygon."""
    unused = np.setdiff1d(np.arange(len(points)), cut)
    before, after = points[unused - 1], points[(unused + 1) % len(points)]
    across = np.linalg.norm(np.cross(points[unused] - before, after - points[unused]), axis=1)
    length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()
    if (across > _SAME_AREA * length**2).any():
        msg = f"face {polygon + 1} of {polygons} is far from plane, and concave as seen along its normal; divide it"
        raise MeshFileError(msg)


def _check_areas(
    mesh: PolygonMesh,
    found: Indices,
    owner: Indices,
    normal: Floats,
    size: Floats,
    present: NDArray[np.bool_],
    around: Floats,
) -> None:
    """Raise MeshFileError where the triangles of a polygon do not have its area, seen along its normal."""
    corners = mesh.vertices[mesh.corners[found]]
    double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    along = 0.5 * np.abs(np.einsum("tk,tk->t", double, normal[owner]))
    covered = np.bincount(owner, along, minlength=len(size))
    wrong = present & ~(np.abs(covered - size) <= _SAME_AREA * around**2)
    if wrong.any():
        n = int(np.argmax(wrong))
        msg = (
            f"face {n + 1} of {len(size)} intersects itself, or is far from plane: its outline encloses "
            f"{size[n]:.6g} and its triangles {covered[n]:.6g} (in squares of the unit of the file); "
            "divide it into simple polygons"
        )
        raise MeshFileError(msg)

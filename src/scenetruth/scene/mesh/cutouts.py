"""Surfaces that the opacity of a picture cuts out: triangles divided along the contour of the opacity.

Where opacity, interpolated between texels as the picture is, falls below a limit, there is no surface. Its contour is a
hyperbola within each square of four texels. Triangles are cut along it, so that depth, visibility, shadows and outlines
follow it by the geometry alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.polygon_mesh import MeshFileError

__all__ = ["CutTriangles", "OpacityMap", "WeldedPieces", "cut_out", "weld"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_PIECES = 6  # of the contour within a square of texels: its error is below 0.003 texels
_SAME = 1e-9  # distance below which points are the same, relative to the size of a triangle
_MOST_WINDOW = 64_000_000  # texels that a single triangle may show
_NO_AREA = 1e-12  # of a piece, relative to its triangle
_WELD = 1e-7  # largest difference of the shares of a side at which two triangles have the same point


@dataclass(frozen=True, eq=False)
class OpacityMap:
    """Opacity of a material and where it lies on the triangles.

    ``alpha``: Opacity at the centres of the texels, shape (height, width).
    ``uv``: Texture coordinates of the corners with v downwards, shape (m, 3, 2).
    ``wrap``: Continuation beyond the picture along u and v: ``repeat``, ``mirror`` or ``clamp``.
    ``limit``: Opacity from which on there is a surface.
    """

    alpha: NDArray[np.float32]
    uv: Floats
    wrap: tuple[str, str]
    limit: float

    def texels(self) -> Floats:
        """Return the coordinates of the corners in texels, in which the centres of texels are integers."""
        height, width = self.alpha.shape
        return np.asarray(self.uv * (width, height) - 0.5)

    def window(self, low: Indices, high: Indices) -> Floats:
        """Return the opacity of the texels from ``low`` to ``high`` (x, y), inclusive."""
        index = [
            _continued(np.arange(low[axis], high[axis] + 1), self.alpha.shape[1 - axis], self.wrap[axis])
            for axis in range(2)
        ]
        return self.alpha[index[1]][:, index[0]].astype(np.float64)


def _continued(texels: Indices, size: int, mode: str) -> Indices:
    if mode == "clamp":
        return np.clip(texels, 0, size - 1)
    if mode == "repeat":
        return texels % size
    place = texels % (2 * size)
    return np.where(place < size, place, 2 * size - 1 - place)


class CutTriangles(NamedTuple):
    """Triangles of the remaining surface, whose corners lie on given triangles."""

    source: Indices
    """Given triangle of every triangle, shape (t,)."""
    weights: Floats
    """Weights of the corners of the given triangle at the corners of every triangle, shape (t, 3, 3)."""
    cut: int
    """Number of given triangles that were divided."""
    removed: int
    """Number of given triangles without any surface."""


def cut_out(opacity: OpacityMap) -> CutTriangles:
    """Divide triangles along the contour of their opacity.

    Raises
    ------
    MeshFileError
        If a triangle shows more of a repeated picture than can be divided.
    """
    whole = np.eye(3)
    texels = opacity.texels()
    sources: list[Indices] = []
    weights: list[Floats] = []
    cut = removed = 0
    for n, corners in enumerate(texels):
        low, high = (
            np.floor(corners.min(axis=0)).astype(np.int64) - 1,
            np.ceil(corners.max(axis=0)).astype(np.int64) + 1,
        )
        size = high - low + 1
        if int(size[0]) * int(size[1]) > _MOST_WINDOW:
            msg = f"has triangle {n + 1} that shows {size[0]:,} x {size[1]:,} texels of a picture with cut-outs"
            raise MeshFileError(msg)
        window = opacity.window(low, high)
        if window.min() >= opacity.limit:
            sources.append(np.array([n]))
            weights.append(whole[None])
            continue
        found = None
        if window.max() >= opacity.limit:
            found = _divide(window, corners - low, opacity.limit)
        if found is None or not len(found):
            removed += 1
            continue
        cut += 1
        sources.append(np.full(len(found), n))
        weights.append(found)
    if not sources:
        return CutTriangles(np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)), cut, removed)
    return CutTriangles(np.concatenate(sources), np.concatenate(weights), cut, removed)


def _divide(window: Floats, corners: Floats, limit: float) -> Floats | None:
    """Return the weights of the pieces of a triangle where the opacity suffices, shape (t, 3, 3)."""
    import shapely

    edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=-1)
    area = float(np.linalg.det(edges))
    extent = float(np.abs(edges).max())
    if abs(area) <= _SAME * max(extent, 1e-300) ** 2:
        # Without an area in the picture, a triangle shows one opacity.
        middle = corners.mean(axis=0)
        return np.eye(3)[None] if float(_bilinear(window, middle[None])[0]) >= limit else None
    triangle = shapely.Polygon(corners)
    pieces: list[Floats] = []
    for rings in _opaque_areas(window, limit):
        area_of_rings = shapely.Polygon(rings[0], rings[1:])
        if not area_of_rings.is_valid:
            area_of_rings = shapely.make_valid(area_of_rings)
        pieces += _triangles(shapely.intersection(triangle, area_of_rings))
    if not pieces:
        return None
    points = np.concatenate(pieces)
    inner = np.linalg.solve(edges, (points.reshape(-1, 2) - corners[0]).T).T.reshape(-1, 3, 2)
    found = np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)
    # On sides and corners, exactly: pieces of adjacent triangles have common points there.
    found = np.where(np.abs(found) < _SAME, 0.0, found)
    found /= found.sum(axis=2, keepdims=True)
    sizes = np.linalg.det(found)
    found = np.where((sizes < 0)[:, None, None], found[:, ::-1], found)
    return np.asarray(found[np.abs(sizes) > _NO_AREA])


def _bilinear(window: Floats, points: Floats) -> Floats:
    """Return the opacity at points (n, 2) by bilinear interpolation."""
    x, y = points[:, 0], points[:, 1]
    column = np.clip(np.floor(x).astype(np.int64), 0, window.shape[1] - 2)
    row = np.clip(np.floor(y).astype(np.int64), 0, window.shape[0] - 2)
    u, v = x - column, y - row
    top = (1 - u) * window[row, column] + u * window[row, column + 1]
    below = (1 - u) * window[row + 1, column] + u * window[row + 1, column + 1]
    return np.asarray((1 - v) * top + v * below)


def _opaque_areas(window: Floats, limit: float) -> Iterator[list[Floats]]:
    """Give outline and holes of every connected area in which the opacity suffices."""
    import contourpy

    generator = contourpy.contour_generator(z=window, fill_type=contourpy.FillType.OuterOffset)
    areas: Any = generator.filled(limit, np.inf)
    for own, ends in zip(areas[0], areas[1], strict=True):
        rings = [own[first:last] for first, last in itertools.pairwise(ends)]
        yield [_on_contour(window, ring, limit) for ring in rings]


def _on_contour(window: Floats, ring: Floats, limit: float) -> Floats:
    """Return a ring whose chords between sides of the squares of texels follow the hyperbola of the opacity."""
    first, last = ring[:-1], ring[1:]
    at_limit = np.abs(_bilinear(window, ring) - limit) < 1e-6
    bent = at_limit[:-1] & at_limit[1:]
    chord = last - first
    length = np.linalg.norm(chord, axis=1)
    bent &= length > 1e-6
    normal = np.column_stack([-chord[:, 1], chord[:, 0]]) / np.where(length > 0, length, 1.0)[:, None]
    # The opacity of the square of a chord is a + b x + c y + d x y from its first texel.
    middle = 0.5 * (first + last)
    column = np.clip(np.floor(middle[:, 0]).astype(np.int64), 0, window.shape[1] - 2)
    row = np.clip(np.floor(middle[:, 1]).astype(np.int64), 0, window.shape[0] - 2)
    a, right = window[row, column], window[row, column + 1]
    down, across = window[row + 1, column], window[row + 1, column + 1]
    b, c, d = right - a, down - a, a - right - down + across
    shares = np.arange(1, _PIECES) / _PIECES
    inner = first[:, None] + shares[:, None] * chord[:, None]
    x, y = inner[..., 0] - column[:, None], inner[..., 1] - row[:, None]
    value = (a - limit)[:, None] + b[:, None] * x + c[:, None] * y + d[:, None] * x * y
    slope = (b[:, None] + d[:, None] * y) * normal[:, None, 0] + (c[:, None] + d[:, None] * x) * normal[:, None, 1]
    second = (d * normal[:, 0] * normal[:, 1])[:, None]
    # The root of value + slope s + second s² that is 0 for a straight contour.
    root = np.sqrt(np.maximum(slope**2 - 4 * second * value, 0.0))
    below = slope + np.where(slope < 0, -root, root)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.where(below != 0, -2 * value / below, 0.0)
    near = np.abs(moved) < 0.5
    inner = inner + np.where(near, moved, 0.0)[..., None] * normal[:, None]
    rows = np.concatenate([first[:, None], inner], axis=1)
    kept = np.ones(rows.shape[:2], dtype=np.bool_)
    kept[~bent, 1:] = False
    return np.concatenate([rows[kept], ring[-1:]])


def _triangles(shape: object) -> list[Floats]:
    """Return the triangles of the polygons of a shape, shape (t, 3, 2) each."""
    import mapbox_earcut
    import shapely

    found = []
    for part in shapely.get_parts(shape):
        if part.geom_type == "GeometryCollection":
            found += _triangles(part)
            continue
        if part.geom_type != "Polygon" or part.is_empty or part.area == 0:
            continue
        rings = [shapely.get_coordinates(ring)[:-1] for ring in (part.exterior, *part.interiors)]
        points = np.concatenate(rings)
        ends = np.cumsum([len(ring) for ring in rings]).astype(np.uint32)
        cut = np.asarray(mapbox_earcut.triangulate_float64(points, ends), dtype=np.int64)
        found.append(points[cut.reshape(-1, 3)])
    return found


class WeldedPieces(NamedTuple):
    """Vertices of cut triangles, which those of adjacent triangles share."""

    triangles: Indices
    """Vertices of every triangle, shape (t, 3)."""
    source: Indices
    """Given triangle on which each vertex lies, shape (n,)."""
    weights: Floats
    """Weights of its corners at each vertex, shape (n, 3)."""


def weld(faces: Indices, cut: CutTriangles) -> WeldedPieces:
    """Return common vertices of the pieces of adjacent triangles.

    Points on a corner are the vertex of the corner; those on a side are the same for both triangles of the side if they
    divide it in the same ratio.

    ``faces``: Vertices of the given triangles, shape (m, 3).
    """
    source = np.repeat(cut.source, 3)
    weights = cut.weights.reshape(-1, 3)
    corner = faces[source]
    count = (weights != 0).sum(axis=1)
    # Vertices of a side, the smaller first, and the share of the larger.
    used = np.where(weights != 0, corner, -1)
    large = used.max(axis=1)
    small = np.where(weights != 0, corner, np.iinfo(np.int64).max).min(axis=1)
    share = np.where(used == large[:, None], weights, 0.0).sum(axis=1)
    first = np.where(count == 3, source, small)
    second = np.where(count == 2, large, 0)
    one = np.where(count == 3, weights[:, 0], np.where(count == 2, share, 0.0))
    two = np.where(count == 3, weights[:, 1], 0.0)
    order = np.lexsort((two, one, second, first, count))
    sorted_ = [each[order] for each in (count, first, second, one, two)]
    new = np.zeros(len(order), dtype=np.bool_)
    new[:1] = True
    for each in sorted_[:3]:
        new[1:] |= each[1:] != each[:-1]
    for each in sorted_[3:]:
        new[1:] |= np.abs(each[1:] - each[:-1]) > _WELD
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    chosen = order[new]
    return WeldedPieces(number.reshape(-1, 3), source[chosen], weights[chosen])

"""Leaf meshes: triangulation of the flat blade, and the map that shapes it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene.leaf.leaf_model import LeafForm
from scenetruth.scene.leaf.margin import Margin, compute_entire_margin, compute_margin
from scenetruth.scene.mesh import MeshSize, TriangleMesh

__all__ = ["LeafMesh", "LeafShape"]


Points = tuple[Any, Any, Any]


@dataclass(frozen=True)
class LeafShape:
    """Undulation, fold, transverse and longitudinal bending, in this order; all smooth.

    Points are fields (x, y, z): arrays of any floating type, or objects that support NumPy arithmetic.

    ``wave_per_mm``: Wave height over the squared distance from the midrib, 1/mm.
    ``wave_number_per_mm``: Angular wave number along the midrib, rad/mm.
    ``fold_rad``: Angle between each half and the plane; positive towards the upper side (-Z).
    ``fold_width_mm``: Width of the rounded fold.
    ``across_per_mm``, ``along_per_mm``: Curvatures; positive towards the upper side.
    """

    wave_per_mm: float = 0.0
    wave_number_per_mm: float = 0.0
    fold_rad: float = 0.0
    fold_width_mm: float = 1.0
    across_per_mm: float = 0.0
    along_per_mm: float = 0.0

    def __call__(self, points: Points, t: Any) -> Points:
        """Map points of the sheet; independent of time."""
        x, y, z = points
        height = -z
        if self.wave_per_mm != 0:
            height = height + self.wave_per_mm * y * y * np.sin(self.wave_number_per_mm * x)
        if self.fold_rad != 0:
            y, height = _folded(y, height, self.fold_rad, self.fold_width_mm)
        if self.across_per_mm != 0:
            y, height = _rolled(y, height, self.across_per_mm)
        if self.along_per_mm != 0:
            x, height = _rolled(x, height, self.along_per_mm)
        return x, y, -height


def _rolled(along: Any, height: Any, curvature: float) -> tuple[Any, Any]:
    """Bend a sheet over a circular arc; offsets from the sheet stay normal to it."""
    turn = curvature * along
    half = np.sin(turn / 2)
    return np.sin(turn) / curvature - height * np.sin(turn), 2 * half * half / curvature + height * np.cos(turn)


def _folded(along: Any, height: Any, angle: float, width: float) -> tuple[Any, Any]:
    """Fold a sheet into a hyperbola with inclined asymptotes; isometric far from the fold."""
    rounding = width / 2
    # Minus the rounding, so that the fold line stays in place.
    rise = np.sqrt(along * along + rounding * rounding) - rounding
    return along * np.cos(angle), height + np.sin(angle) * rise


def make_leaf_shape(leaf: LeafForm) -> LeafShape:
    """Return the shape map of a leaf."""
    half = leaf.full_width_mm / 2
    waves = leaf.undulation
    fold_width = leaf.full_width_mm / 10 if leaf.fold_width_mm is None else leaf.fold_width_mm
    return LeafShape(
        wave_per_mm=0.0 if waves is None else waves.amplitude_mm / half**2,
        wave_number_per_mm=0.0 if waves is None else 2 * float(np.pi) * waves.waves_per_side / leaf.length_mm,
        fold_rad=float(np.radians(leaf.fold_deg)) / 2,
        fold_width_mm=fold_width,
        across_per_mm=float(np.radians(leaf.bend_across_deg)) / (2 * half),
        along_per_mm=float(np.radians(leaf.bend_along_deg)) / leaf.length_mm,
    )


Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROW = float(np.sqrt(3) / 2)
_CLEAR = 0.62  # lattice points closer to the margin are omitted; all lengths in lattice edges
_FREE = 2.0  # closer points move to equalise triangles
_DEEP = 3.0  # beyond, triangles are those of the lattice
_BAND = 5.0  # up to here points are retriangulated
_ROUNDS = 8
_ATTEMPTS = 8


@dataclass(frozen=True, eq=False)
class _Half:
    """The half of a leaf with b >= 0: points of rim (rear end of the axis to tip), axis and lattice, in this order.

    The depth is the distance of axis and lattice points from the rim, at most `_BAND`, in edges.
    """

    edge: float
    rim: Floats
    axis: Floats
    lattice: Floats
    depth: Floats
    deep_faces: Indices

    @property
    def points(self) -> Floats:
        return np.concatenate([self.rim, self.axis, self.lattice])


@lru_cache(maxsize=32)
def triangulate_leaf(leaf: LeafForm) -> tuple[Floats, NDArray[np.int32]]:
    """Triangulate a flat leaf symmetrically about the midrib: vertices (a, b) in mm, and faces, upper side to -Z.

    Scenes of a data set, also plants with many leaves, are built for the acceptance test and again for the images.
    """
    edge = leaf.length_mm / max(round(leaf.length_mm / leaf.resolution_mm), 2)
    margin = compute_margin(leaf)
    rim = _resampled(margin, edge)
    for _ in range(_ATTEMPTS):
        half = _half(leaf, rim, edge)
        points, faces = _triangulated(half)
        missing = _missing_edges(faces, len(rim))
        if not len(missing):
            break
        rim = np.insert(rim, missing + 1, (rim[missing] + rim[missing + 1]) / 2, axis=0)
    outline = np.concatenate([rim, half.axis[::-1]])
    if len(missing) or abs(_areas(points, faces).sum() - _polygon_area(outline)) > 1e-9 * _polygon_area(outline):
        remedy = "the margin intersects itself; use shallower or fewer teeth, shorter lobes, or a thinner petiole"
        raise SceneError([Problem("outline", remedy, leaf.outline)])
    on_axis = np.zeros(len(points), dtype=bool)
    on_axis[[0, len(rim) - 1]] = True
    on_axis[len(rim) : len(rim) + len(half.axis)] = True
    twin = np.arange(len(points))
    twin[~on_axis] = len(points) + np.arange(np.count_nonzero(~on_axis))
    points = np.concatenate([points, points[~on_axis] * (1, -1)])
    # Positive areas are oriented from a to b, away from the camera.
    faces = np.concatenate([faces[:, ::-1], twin[faces]])
    triangles = faces.astype(np.int32)
    points.flags.writeable = triangles.flags.writeable = False
    return points, triangles


def _resampled(margin: Margin, edge: float) -> Floats:
    """Return the margin with equal steps of about an edge length between its corners."""
    points = margin.points_mm
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    places = []
    for start, end in zip(arc[margin.corners[:-1]], arc[margin.corners[1:]], strict=True):
        places.append(np.linspace(start, end, max(round((end - start) / edge), 1), endpoint=False))
    chosen = np.concatenate([*places, arc[-1:]])
    return np.column_stack([np.interp(chosen, arc, points[:, 0]), np.interp(chosen, arc, points[:, 1])])


def _half(leaf: LeafForm, rim: Floats, edge: float) -> _Half:
    from scipy.spatial import cKDTree

    from scenetruth.scene.leaf.leaf_kernels import inside

    behind, length = -float(rim[0, 0]), leaf.length_mm
    steps = round(length / edge)
    first = -max(round(behind / edge) - 1, 0) if behind > 0 else 1
    along = np.arange(first, steps) * edge
    rows = np.arange(1, int(rim[:, 1].max() / (_ROW * edge)) + 1)
    columns = np.arange(int(np.floor(rim[:, 0].min() / edge)) - 1, steps + 2)
    place = np.stack(np.broadcast_arrays(columns + 0.5 * (rows % 2)[:, None], _ROW * rows[:, None]), axis=-1) * edge
    lattice: Floats = place.reshape(-1, 2)
    # Distances from the rim, approximated by dense points.
    share = np.linspace(0, 1, 8, endpoint=False)[None, :, None]
    dense = (rim[:-1, None] * (1 - share) + rim[1:, None] * share).reshape(-1, 2)
    tree = cKDTree(np.concatenate([dense, rim[-1:]]))

    def compute_depth(points: Any) -> Any:
        found = tree.query(points, distance_upper_bound=_BAND * edge)[0] / edge
        return np.minimum(found, _BAND)

    axis: Floats = np.column_stack([along, np.zeros(len(along))])
    depth = compute_depth(lattice)
    kept = depth > _CLEAR
    kept[kept] = inside(lattice[kept], np.concatenate([rim, axis[::-1]]))
    number = np.full((len(rows) + 1, len(columns)), -1)
    number[1:].ravel()[kept] = len(rim) + len(axis) + np.arange(np.count_nonzero(kept))
    number[0, first - columns[0] :][: len(axis)] = len(rim) + np.arange(len(axis))
    depths = np.concatenate([np.zeros(len(rim)), compute_depth(axis), depth[kept]])
    deep = _lattice_faces(number)
    deep = deep[(deep >= 0).all(axis=1)]
    deep = deep[depths[deep].mean(axis=1) > _DEEP]
    return _Half(edge, rim, axis, lattice[kept], depths[len(rim) :], deep)


def _lattice_faces(number: Indices) -> Indices:
    """Return the triangles of a lattice with odd rows shifted by half an edge; -1 is a missing point."""
    lower, upper = number[:-1], number[1:]
    odd = (np.arange(len(lower)) % 2 == 1)[:, None]
    a, b, c, d = lower[:, :-1], lower[:, 1:], upper[:, :-1], upper[:, 1:]
    # Above an even row: (a, b, c) and (b, d, c); above an odd row: (a, b, d) and (a, d, c).
    one = np.stack([a, b, np.where(odd, d, c)], axis=-1)
    two = np.stack([np.where(odd, a, b), d, c], axis=-1)
    return np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])


def _triangulated(half: _Half) -> tuple[Floats, Indices]:
    """Return points and faces of a half, with positive face areas."""
    points = half.points
    rim, fixed = len(half.rim), len(half.rim) + len(half.axis)
    depth = np.concatenate([np.zeros(rim), half.depth])
    band = np.flatnonzero(depth < _BAND)
    free = np.flatnonzero((depth < _FREE) & (np.arange(len(points)) >= fixed))
    outline = np.concatenate([half.rim, half.axis[::-1]])
    faces = _band_faces(points, band, depth, outline, half.edge)
    for _ in range(_ROUNDS if len(free) else 0):
        points = _evened(points, faces, free)
        faces = _band_faces(points, band, depth, outline, half.edge)
    return points, np.concatenate([faces, half.deep_faces])


def _band_faces(points: Floats, band: Indices, depth: Floats, outline: Floats, edge: float) -> Indices:
    from scipy.spatial import Delaunay

    from scenetruth.scene.leaf.leaf_kernels import inside

    faces = band[Delaunay(points[band]).simplices]
    area = _areas(points, faces)
    faces[area < 0] = faces[area < 0][:, ::-1]
    faces = faces[(depth[faces].mean(axis=1) <= _DEEP) & (np.abs(area) > 1e-9 * edge**2)]
    chosen: Indices = faces[inside(points[faces].mean(axis=1), outline)]
    return chosen


def _evened(points: Floats, faces: Indices, free: Indices) -> Floats:
    """Move each free point to the mean of its neighbours."""
    ends, others = faces[:, [0, 1, 2, 1, 2, 0]].ravel(), faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    count = np.bincount(ends, minlength=len(points))
    middle = np.column_stack([np.bincount(ends, points[others, k], len(points)) for k in (0, 1)])
    moved = points.copy()
    moved[free] = middle[free] / np.maximum(count[free], 1)[:, None]
    return moved


def _missing_edges(faces: Indices, rim: int) -> Indices:
    """Return the indices of rim edges without a face."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    present = pairs[(pairs[:, 1] - pairs[:, 0] == 1) & (pairs[:, 1] < rim), 0]
    return np.setdiff1d(np.arange(rim - 1), present)


def _areas(points: Floats, faces: Indices) -> Any:
    first, second, third = points[faces].transpose(1, 2, 0)
    one, two = second - first, third - first
    return (one[0] * two[1] - one[1] * two[0]) / 2


def _polygon_area(polygon: Floats) -> float:
    x, y = polygon.T
    return abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) / 2


# Measured fraction of the area covered by lattice triangles, without teeth and margin triangles.
_MORE_FACES = 0.98
_MARGIN_POINTS, _SKETCHED_POINTS = 400, 48


class LeafMesh(LeafForm):
    """Leaf mesh: X along the midrib from the base (origin) to the tip, Y across, upper side towards -Z."""

    kind: Literal["leaf"]
    """``leaf``."""

    def size(self, folder: Path) -> MeshSize:
        """Return the approximate mesh size from the area of the leaf, see `MeshModel`."""
        a, b = compute_entire_margin(self, _MARGIN_POINTS).T
        area = 2 * abs(float(np.trapezoid(b, a)))
        if self.petiole is not None:
            area += self.petiole.length_mm * self.petiole.diameter_mm
        faces = int(_MORE_FACES * area / (np.sqrt(3) / 4 * self.resolution_mm**2)) + 2
        return MeshSize(faces // 2 + 2 * int(self.length_mm / self.resolution_mm) + 2, faces)

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh:
        """Return strips between midrib and margin, without teeth, see `MeshModel`."""
        rim = compute_entire_margin(self, _MARGIN_POINTS)
        rim = rim[np.unique(np.linspace(0, len(rim) - 1, _SKETCHED_POINTS).astype(np.int64))]
        if self.petiole is not None:
            stalk = np.array([[-self.petiole.length_mm, self.petiole.diameter_mm / 2]])
            rim = np.concatenate([stalk, rim])
        middle = np.column_stack([rim[:, 0], np.zeros(len(rim))])
        material = np.concatenate([middle, rim, rim * (1, -1)])
        count = len(rim)
        here = np.arange(count - 1)
        halves = []
        for side, turned in ((count, False), (2 * count, True)):
            # Positive areas are oriented from a to b, as in the full mesh.
            one = np.column_stack([here, here + 1, side + here + 1])
            two = np.column_stack([here, side + here + 1, side + here])
            faces = np.concatenate([one, two])
            halves.append(faces if turned else faces[:, ::-1])
        return self._mesh(material, np.concatenate(halves).astype(np.int32))

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the leaf, with the flat sheet including the petiole as chart; an image covers the blade."""
        return self._mesh(*triangulate_leaf(self))

    def _mesh(self, material: NDArray[np.float64], faces: NDArray[np.int32]) -> TriangleMesh:
        shape = make_leaf_shape(self)
        a, b = material.T
        vertices = np.column_stack(shape((a, b, np.zeros_like(a)), np.zeros(1)))
        behind, half = float(compute_entire_margin(self)[:, 0].min()), self.full_width_mm / 2
        image = (material - (behind, -half)) / (self.length_mm - behind, 2 * half)
        return TriangleMesh(
            vertices,
            faces,
            chart_mm=material[faces],
            uv=image[faces],
            crease_deg=60.0,
            material_mm=material,
            shape=shape,
            source=self,
        )

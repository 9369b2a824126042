"""Sampled surface points visible to the reference camera: position, orientation, motion and illumination."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.motion_selection import PointNeighbourhood
from scenetruth.bound.surface_geometry import ReferencePoints
from scenetruth.design.prediction.camera_response import compute_irradiance
from scenetruth.resources import ObjectWorkload
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import make_point_maps
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.motion import PointMap
from scenetruth.scene.reference_configuration import ReferenceConfiguration, make_reference_configuration
from scenetruth.scene.vertex_animation import VertexModel

if TYPE_CHECKING:
    from scenetruth.design.prediction.surface_light import SurfaceLight

__all__ = ["SurfaceSamples", "label_patches", "rasterise", "sample_surface"]


Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

_SLACK = 1e-9  # tolerance of the point-in-triangle test, relative to the triangle, which avoids gaps between neighbours
_AT_A_TIME = 2_000_000  # pairs of a triangle and a pixel in its bounding box per batch


def rasterise(corners_mm: Array, focal_px: float, x_px: Array, y_px: Array) -> Numbers:
    """Return the nearest triangle, given corners (m, 3, 3) in camera coordinates, at image points; -1 for none."""
    width, height = len(x_px), len(y_px)
    nearest = np.zeros(width * height)
    face = np.full(width * height, -1, dtype=np.int64)
    ahead = np.flatnonzero((corners_mm[..., 2] > 0).all(axis=1))
    inverse = 1.0 / corners_mm[ahead, :, 2]
    x, y = (focal_px * corners_mm[ahead, :, k] * inverse for k in range(2))
    left, right = _span(x, x_px)
    top, bottom = _span(y, y_px)
    across, down = np.maximum(right - left, 0), np.maximum(bottom - top, 0)
    counts = across * down
    ends = np.cumsum(counts)
    first = 0
    while first < len(ahead):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + _AT_A_TIME, side="right")), first + 1)
        some = np.arange(first, last)
        triangle = np.repeat(some, counts[some])
        place = np.arange(len(triangle)) - np.repeat(ends[some] - counts[some] - before, counts[some])
        column = left[triangle] + place % np.maximum(across[triangle], 1)
        row = top[triangle] + place // np.maximum(across[triangle], 1)
        with np.errstate(all="ignore"):
            # Triangles seen edge-on have no area.
            found = _inverse_depth(x[triangle], y[triangle], inverse[triangle], x_px[column], y_px[row])
        hit = found > 0
        pixel, found, triangle = (row * width + column)[hit], found[hit], triangle[hit]
        order = np.lexsort((found, pixel))
        pixel, found, triangle = pixel[order], found[order], triangle[order]
        # The last entry of each pixel is the nearest.
        closest = np.ones(len(pixel), dtype=np.bool_)
        closest[:-1] = pixel[1:] != pixel[:-1]
        pixel, found, triangle = pixel[closest], found[closest], triangle[closest]
        better = found > nearest[pixel]
        nearest[pixel[better]], face[pixel[better]] = found[better], ahead[triangle[better]]
        first = last
    return face.reshape(height, width)


def label_patches(face: Numbers, normals: Array, body: Numbers, most_turned: Array) -> Numbers:
    """Label surface segments: connected pixels of one body whose neighbouring normals differ by less than a limit.

    ``normals``: Unit normals (m, 3) towards the camera. Returns: Labels in the shape of ``face``, -1 for background.
    """
    number = np.arange(face.size).reshape(face.shape)
    seen = face >= 0
    own, normal = np.where(seen, body[face], -1), normals[face]
    pairs = []
    for one, other in (((slice(None), slice(1, None)), (slice(None), slice(-1))), (slice(1, None), slice(-1))):
        same = (own[one] == own[other]) & seen[one] & seen[other]
        same &= (normal[one] * normal[other]).sum(axis=-1) >= most_turned[own[one]]
        pairs.append(np.stack([number[one][same], number[other][same]]))
    one, other = np.concatenate(pairs, axis=1)
    label = number.ravel().copy()
    while True:
        least = np.minimum(label[one], label[other])
        before = label.copy()
        np.minimum.at(label, label[one], least)
        np.minimum.at(label, label[other], least)
        label = label[label]
        if (label == before).all():
            break
    return np.where(seen, label.reshape(face.shape), -1)


def _span(corners: Array, places: Array) -> tuple[Numbers, Numbers]:
    """Return the first and the last + 1 of the evenly spaced positions between the corners of triangles."""
    step = places[1] - places[0] if len(places) > 1 else 1.0
    low, high = (each - places[0] for each in (corners.min(axis=1), corners.max(axis=1)))
    first = np.clip(np.ceil(low / step - _SLACK), 0, len(places)).astype(np.int64)
    last = np.clip(np.floor(high / step + _SLACK) + 1, 0, len(places)).astype(np.int64)
    return first, last


def _inverse_depth(x: Array, y: Array, inverse: Array, at_x: Array, at_y: Array) -> Array:
    """Return 1/Z of triangles at image points, which is linear in the image; 0 outside."""
    one_x, one_y, two_x, two_y = (each[:, k] - each[:, 0] for k in (1, 2) for each in (x, y))
    area = one_x * two_y - one_y * two_x
    p_x, p_y = at_x - x[:, 0], at_y - y[:, 0]
    b = (p_x * two_y - p_y * two_x) / area
    c = (one_x * p_y - one_y * p_x) / area
    inside = (b >= -_SLACK) & (c >= -_SLACK) & (b + c <= 1 + _SLACK)
    value = inverse[:, 0] + b * (inverse[:, 1] - inverse[:, 0]) + c * (inverse[:, 2] - inverse[:, 0])
    return np.where(inside, value, 0.0)


Mask = NDArray[np.bool_]

# Longer side of the sampling raster in px, and numbers of sampled points.
_PICTURE_PX, _MOST_POINTS, _FEWEST_POINTS = 96, 240, 16
_EDGE_DEG = 30.0  # angle in degrees between neighbouring triangles of a coarse mesh beyond which their edge is a crease
_LOST_PX = 2.5  # pixels within this distance of the end of a surface segment are excluded, as in the Cramér-Rao bound
_HALF_FRAME = 0.5
_LOST, _OUTSIDE = -2, -3  # labels that no segment has; -1 is background


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Sampled surface points visible to the reference camera at the reference frame."""

    points: ReferencePoints  # position and motion
    depth_mm: Array
    normals: Array  # unit vectors towards the camera, shape (n, 3)
    body: Numbers
    names: tuple[str, ...]
    share: Array  # image pixels represented by each point
    chart: Array  # derivative of surface coordinates in mm by px along x and y, shape (n, 2, 2)
    light: Array  # derivative of radiance by texture value
    gloss: Array  # radiance that does not depend on the texture
    growth: Array  # per frame
    principal_growth_rates: Array  # per frame, shape (2, n)
    piece: Numbers  # raster of segment labels
    step_px: float  # spacing of the raster in camera pixels
    first_px: tuple[float, float]  # position (x, y) of its first pixel from the principal point
    left_out: tuple[str, ...]  # names of omitted objects, whose files are slow to read
    reflection: SurfaceLight | None = None  # light of materials and lamps with a size; None if surfaces count as matt

    def __len__(self) -> int:
        return len(self.body)

    def piece_at(self, x_px: Array, y_px: Array) -> Numbers:
        """Return segment labels at positions from the principal point; negative for background and outside."""
        return _at(self.piece, *self._places(x_px, y_px))

    def _places(self, x_px: Array, y_px: Array) -> tuple[Numbers, Numbers]:
        """Return rows and columns in the raster."""
        column, row = (
            np.rint((each - first) / self.step_px).astype(np.int64)
            for each, first in zip((x_px, y_px), self.first_px, strict=True)
        )
        return row, column

    def of(self, bodies: Sequence[int]) -> SurfaceSamples:
        """Return the points of the given objects."""
        kept = np.isin(self.body, bodies)
        names = ("depth_mm", "normals", "body", "share", "chart", "light", "gloss", "growth")
        parts: dict[str, Any] = {name: getattr(self, name)[kept] for name in names}
        parts["principal_growth_rates"] = self.principal_growth_rates[:, kept]
        return replace(self, points=self.points.at((np.flatnonzero(kept),)), **parts)

    def own_around(self, offsets_px: Array) -> Mask:
        """Return whether positions at ``offsets_px`` (m, 2) along x and y are inside the segment of each point."""
        x, y = (each[:, None] + offsets_px[:, k] for k, each in enumerate((self.points.x, self.points.y)))
        own = self.piece_at(self.points.x, self.points.y)[:, None]
        return np.asarray(_at(self._inside, *self._places(x, y)) == own)

    def neighbourhood(self, sigma_px: float) -> PointNeighbourhood:
        """Return the surroundings of the points for averages over the surface."""
        x, y = self.points.x, self.points.y
        return PointNeighbourhood(x, y, self.piece_at(x, y), self.share, sigma_px)

    @cached_property
    def _inside(self) -> Numbers:
        """The raster of labels with -2 at pixels too close to the end of a segment."""
        if self.step_px > 2 * _LOST_PX:
            return self.piece
        rows, columns = self.piece.shape
        x, y = np.meshgrid(
            *(first + self.step_px * np.arange(n) for first, n in zip(self.first_px, (columns, rows), strict=True))
        )
        kept = np.ones(self.piece.shape, dtype=np.bool_)
        for away_x, away_y in ((_LOST_PX, 0), (-_LOST_PX, 0), (0, _LOST_PX), (0, -_LOST_PX)):
            beyond = self._places(x + away_x, y + away_y)
            found = _at(self.piece, *beyond)
            kept &= (found == self.piece) | (found == _OUTSIDE)
        return np.where(kept, self.piece, _LOST)

    def far_from_edges(self, margin_px: float) -> Mask:
        """Return the points without a silhouette or crease within a distance, shape (n,)."""
        reach = np.arange(-np.ceil(margin_px / self.step_px), np.ceil(margin_px / self.step_px) + 1) * self.step_px
        across, down = (each.ravel() for each in np.meshgrid(reach, reach))
        offsets = np.stack([across, down], axis=-1)[np.hypot(across, down) < margin_px]
        x, y = (each[:, None] + offsets[:, k] for k, each in enumerate((self.points.x, self.points.y)))
        own = self.piece_at(self.points.x, self.points.y)[:, None]
        found = self.piece_at(x, y)
        return np.asarray(((found == own) | (found == _OUTSIDE)).all(axis=1))


def _at(picture: Numbers, row: Numbers, column: Numbers) -> Numbers:
    rows, columns = picture.shape
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return np.where(inside, picture[np.where(inside, row, 0), np.where(inside, column, 0)], _OUTSIDE)


@dataclass(frozen=True, eq=False)
class _Body:
    """An object: a coarse mesh and its motion."""

    mesh: TriangleMesh
    start: ReferenceConfiguration
    maps: Sequence[PointMap]
    edge_cos: float

    def at(self, t: float) -> Array:
        """Return the vertex positions at a time in frames, shape (n, 3)."""
        time = np.array([float(t)])
        points = self.start.at(time)
        for item in self.maps:
            points = item(points, time)
        return np.column_stack([np.broadcast_to(field, self.mesh.vertices_mm.shape[:1]) for field in points])


def sample_surface(scene: Scene, parts: Sequence[ObjectWorkload], folder: Path = Path()) -> SurfaceSamples:
    """Sample the visible surface points of a scene from coarse meshes."""
    known = [part for part in parts if part.sketch is not None]
    with np.errstate(all="ignore"):
        bodies = [_body(scene, part, folder) for part in known]
        moments = [[body.at(t) for t in (0.0, -_HALF_FRAME, _HALF_FRAME)] for body in bodies]
    corners = [
        np.concatenate([one[k][body.mesh.faces] for one, body in zip(moments, bodies, strict=True)] or [_NOTHING])
        for k in range(3)
    ]
    number = np.repeat(np.arange(len(bodies)), [len(body.mesh.faces) for body in bodies])
    charts = np.concatenate([body.mesh.chart_mm for body in bodies] or [_NOTHING[..., :2]])
    normals = _normals(corners[0])
    camera = scene.camera
    step = max(max(camera.width, camera.height) / _PICTURE_PX, 1.0)
    c_x, c_y = camera.principal_point
    places = [
        np.asarray((np.arange(max(round(side / step), 1)) + 0.5) * step - 0.5 - centre, dtype=np.float64)
        for side, centre in ((camera.width, c_x), (camera.height, c_y))
    ]
    face = rasterise(corners[0], camera.focal_px, *places)
    edges = np.array([body.edge_cos for body in bodies] or [1.0])
    piece = label_patches(face, normals, number, edges) if len(number) else face
    chosen, share = _chosen(face, number)
    row, column = np.unravel_index(chosen, face.shape)
    triangle = face[row, column]
    x, y = places[0][column], places[1][row]
    points, depth, chart, growth, principal = _points(
        scene, [each[triangle] for each in corners], charts[triangle], x, y
    )
    rays = np.column_stack([x, y, np.full_like(x, camera.focal_px)]) / camera.focal_px
    light = compute_irradiance(scene, depth[:, None] * rays, normals[triangle])
    return SurfaceSamples(
        points=points,
        depth_mm=depth,
        normals=normals[triangle],
        body=number[triangle],
        names=tuple(part.item.name for part in known),
        share=share * step**2,
        chart=chart,
        light=light,
        gloss=np.zeros_like(light),
        growth=growth,
        principal_growth_rates=principal,
        piece=piece,
        step_px=step,
        first_px=(float(places[0][0]), float(places[1][0])),
        left_out=tuple(part.item.name for part in parts if part.sketch is None),
    )


_NOTHING = np.zeros((0, 3, 3))


def _body(scene: Scene, part: ObjectWorkload, folder: Path) -> _Body:
    item, mesh = part.item, part.sketch
    assert mesh is not None
    given = item.deformation[0] if item.deformation else None
    start = (
        given.start(mesh, folder, scene.frames)
        if isinstance(given, VertexModel)
        else make_reference_configuration(mesh)
    )
    # A complete mesh defines its creases; the edges of a coarse mesh are blunter.
    whole = len(mesh.faces) == part.size.faces
    edge = float(np.min(mesh.crease_deg)) if whole and not mesh.smooth else _EDGE_DEG
    return _Body(
        mesh, start, make_point_maps(item, mesh, scene.frames.frame_interval_s), float(np.cos(np.deg2rad(edge)))
    )


def _normals(corners: Array) -> Array:
    """Return unit normals of triangles towards the camera, shape (m, 3)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = across / np.linalg.norm(across, axis=1)[:, None]
    away = (unit * corners[:, 0]).sum(axis=1) > 0
    return np.asarray(np.where(away[:, None], -unit, unit))


def _chosen(face: Numbers, body: Numbers) -> tuple[Numbers, Array]:
    """Return randomly chosen pixels of each object, and the number of pixels that each represents."""
    places = np.flatnonzero(face.ravel() >= 0)
    if not len(places):
        return places, np.zeros(0)
    own = body[face.ravel()[places]]
    rank = _ranks(face.shape).ravel()
    chosen, shares = [], []
    for one in np.unique(own):
        among = places[own == one]
        count = min(len(among), max(_FEWEST_POINTS, round(_MOST_POINTS * len(among) / len(places))))
        chosen.append(np.sort(among[np.argsort(rank[among])[:count]]))
        shares.append(np.full(count, len(among) / count))
    return np.concatenate(chosen), np.concatenate(shares)


@cache
def _ranks(shape: tuple[int, int]) -> Numbers:
    """Return the order in which pixels of a raster are chosen: evenly spread, at random positions, and fixed.

    The next four are in different quadrants of the raster, and the next four of each quadrant in different quadrants of
    it. A pixel more or less of an object changes one point, not all.
    """
    random = np.random.default_rng(0)
    rank = np.zeros((1, 1), dtype=np.int64)
    weight = 1
    while len(rank) < max(shape):
        digits = random.permuted(np.broadcast_to(np.arange(4), (*rank.shape, 4)), axis=-1)
        parts = rank[..., None] + weight * digits
        rank = parts.reshape(*rank.shape, 2, 2).swapaxes(1, 2).reshape(2 * len(rank), 2 * len(rank))
        weight *= 4
    return rank[: shape[0], : shape[1]]


def _points(
    scene: Scene, corners: Sequence[Array], charts: Array, x: Array, y: Array
) -> tuple[ReferencePoints, Array, Array, Array, Array]:
    """Return points on triangles at image positions, their depths, charts, and (principal) growth rates."""
    focal, baseline = scene.camera.focal_px, scene.stage.baseline_mm
    now, before, after = corners
    rays = np.column_stack([x, y, np.full_like(x, focal)])
    one, two = now[:, 1] - now[:, 0], now[:, 2] - now[:, 0]
    normal = np.cross(one, two)
    with np.errstate(invalid="ignore", divide="ignore"):
        toward = (normal * rays).sum(axis=1)
        distance = (normal * now[:, 0]).sum(axis=1) / toward
        place = distance[:, None] * rays
        depth = place[:, 2]
        d = focal * baseline / depth
        d_x, d_y = d * normal[:, 0] / toward, d * normal[:, 1] / toward
        # Barycentric weights from scalar products with the edges.
        gram = np.stack([np.stack([(a * b).sum(axis=1) for b in (one, two)]) for a in (one, two)])
        area = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2

        def along(vectors: Array) -> Array:
            right = [(vectors * edge).sum(axis=1) for edge in (one, two)]
            b = (gram[1, 1] * right[0] - gram[0, 1] * right[1]) / area
            return np.stack([b, (gram[0, 0] * right[1] - gram[0, 1] * right[0]) / area])

        weights = along(place - now[:, 0])
        velocity = after - before
        own = velocity[:, 0] + np.einsum("kn,nkc->nc", weights, velocity[:, 1:] - velocity[:, :1])
        zero = np.zeros((3, len(x)))
        points = ReferencePoints(x, y, d, d_x, d_y, own.T / baseline, zero, zero, focal)
        tangents = [baseline * np.moveaxis(side, 0, -1) for side in points.tangents()]
        q_x, q_y = (
            np.einsum("kn,nkc->cn", along(side), velocity[:, 1:] - velocity[:, :1]) / baseline for side in tangents
        )
        points = replace(points, q_x=q_x, q_y=q_y)
        steps = charts[:, 1:] - charts[:, :1]
        chart = np.stack([np.einsum("kn,nkc->nc", along(side), steps) for side in tangents], axis=-1)
        areas = [np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1) for c in (before, after)]
        growth = np.log(areas[1] / areas[0])
        # Rates of the metric g of the edges, ½ dg/dt.
        change = [velocity[:, 1] - velocity[:, 0], velocity[:, 2] - velocity[:, 0]]
        mixed = np.stack([np.stack([(a * b).sum(axis=1) for b in change]) for a in (one, two)])
        rate = 0.5 * (mixed + mixed.swapaxes(0, 1))
        trace = (gram[1, 1] * rate[0, 0] - 2 * gram[0, 1] * rate[0, 1] + gram[0, 0] * rate[1, 1]) / area
        product = (rate[0, 0] * rate[1, 1] - rate[0, 1] ** 2) / area
        spread = np.sqrt(np.maximum((0.5 * trace) ** 2 - product, 0.0))
        # The sum from areas is more accurate: over a frame, it is the change of the logarithm.
        principal = np.stack([0.5 * growth + spread, 0.5 * growth - spread])
    return points, depth, chart, growth, principal

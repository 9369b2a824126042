"""Mixed pixels, whose footprint crosses a silhouette or a crease."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast.ray_caster import RayCaster

__all__ = ["Changes", "MixedPixels", "SurfaceLines", "find_mixed_pixels", "mixed_pixels", "places_in_pixels"]

_NEAR = 1e-6  # near clipping depth of edges in mm
_TOUCH_PX = 1e-6  # distance from a pixel border in px below which a line belongs to both pixels
_PIECE_PX = 1 / 64  # piece length of lines curved by distortion; pixels touched over a shorter length may be missed
_HIDDEN = 1e-7  # relative depth tolerance for the occlusion of edge points


@dataclass(frozen=True, eq=False)
class MixedPixels:
    """Mixed pixels of an image with the edges in them.

    ``mixed``: Pixels whose footprint crosses a visible edge, shape (height, width).
    ``bare``: Those of them without an edge, where bodies intersect, shape (height, width).
    ``pixels``: Index of the pixel of each edge, hidden or not, in mixed pixels, ascending, shape (k,).
    ``ends``: Ends x0, y0, x1, y1 of these edges relative to the pixel centre in px, also outside the pixel, shape
      (k, 4). Rays are linear in x and y, as in `ImageRays`.
    ``seen``: Whether any tested piece of the edge in this pixel is visible, shape (k,).
    ``surfaces``: The mixed pixels without `SurfaceLines`, shape (height, width); None if they are not wanted.
    """

    mixed: NDArray[np.bool_]
    bare: NDArray[np.bool_]
    pixels: NDArray[np.int64]
    ends: NDArray[np.float64]
    seen: NDArray[np.bool_]
    surfaces: NDArray[np.bool_] | None = None


class SurfaceLines(NamedTuple):
    """Straight lines on faces, treated as edges where something changes across them.

    ``starts_mm``, ``ends_mm``: Ends in mm, shape (k, 3) each.
    ``face``, ``body``: Face of each line and its body, shape (k,).
    ``label``: Number of each line for `Changes`, shape (k,).
    """

    starts_mm: NDArray[np.float64]
    ends_mm: NDArray[np.float64]
    face: NDArray[np.int32]
    body: NDArray[np.int32]
    label: NDArray[np.int64]


Changes = Callable[[NDArray[np.float64], NDArray[np.int64], "SurfaceLines"], NDArray[np.bool_]]
"""Function that returns where something changes across lines: at points, shape (n, 3), on lines with an index (n,)."""


class _Pieces(NamedTuple):
    """Pieces of projected edges: positions in px, shape (k, 2); edge, shape (k,); and whether each is visible.

    ``ends_mm``: Ends of the edges in camera coordinates, shape (n, 2, 3).
    """

    positions: NDArray[np.float64]
    edge: NDArray[np.int64]
    seen: NDArray[np.bool_]
    ends_mm: NDArray[np.float64]


def mixed_pixels(
    caster: RayCaster, viewpoint: Viewpoint, camera: Camera, bodies: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Mark the pixels whose footprint [x ± 1/2] x [y ± 1/2] crosses a visible silhouette or sharp edge.

    Silhouette edges (mesh boundaries, or between a front and a back face) and sharp edges (face angle above the crease
    angle) are projected, split at the pixel borders, and each piece is tested for visibility.

    ``bodies``: Body index at every pixel centre, shape (height, width), -1 for none. Where it changes between two
      pixels without an edge (intersecting bodies), both pixels are marked.
    """
    mixed, _bare, _pieces = _marked(caster, viewpoint, camera, bodies)
    return mixed


def find_mixed_pixels(
    caster: RayCaster,
    viewpoint: Viewpoint,
    camera: Camera,
    bodies: NDArray[np.int32],
    lines: SurfaceLines | None = None,
    changes: Changes | None = None,
    *,
    apart: bool = False,
) -> MixedPixels:
    """Find the mixed pixels, see `mixed_pixels`, and the edges in them.

    ``lines``: Other lines, which make the pixels mixed that they cross where something changes.
    ``apart``: Whether the mixed pixels without these lines are wanted as well.
    """
    mixed, bare, pieces = _marked(caster, viewpoint, camera, bodies, lines, changes)
    surfaces = None
    if apart:
        surfaces = np.zeros_like(mixed)
        of_edges = len(pieces.ends_mm) - (0 if lines is None else len(lines.face))
        _mark(surfaces, pieces.positions[pieces.seen & (pieces.edge < of_edges)])
        _mark_unmarked_borders(surfaces, bodies)
    columns, rows = _pixels_of(pieces.positions, mixed.shape)
    pixels = rows * camera.width + columns
    inside = np.flatnonzero(mixed.ravel()[pixels])
    edges = len(pieces.ends_mm)
    # Distortion divides the part of an edge in a pixel into several pieces.
    parts, of_part = np.unique(pixels[inside] * edges + pieces.edge[inside], return_inverse=True)
    seen = np.zeros(len(parts), dtype=np.bool_)
    seen[of_part[pieces.seen[inside]]] = True
    pixels, edge = np.divmod(parts, edges)
    rays, corners = pixel_rays(camera), pieces.ends_mm[edge]
    _cut_in_front(corners)
    ends = places_in_pixels(rays.directions, rays.steps, camera.width, pixels, corners)[1].reshape(-1, 4)
    return MixedPixels(mixed, bare, pixels, ends, seen, surfaces)


def places_in_pixels(
    directions: NDArray[np.float64],
    steps: tuple[NDArray[np.float64], NDArray[np.float64]],
    width: int,
    pixels: NDArray[np.int64],
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the multiples of points, shape (n, m), and their offsets (x, y) from pixel centres in px, shape (n, m, 2).

    A point is on the ray at x, y of a pixel if it is a multiple of the direction + x across + y down.

    ``directions``, ``steps``: See `ImageRays`.
    ``pixels``: Pixel of each group of points, shape (n,). ``points``: Relative to the origin of the rays, (n, m, 3).
    """
    across, down = steps
    if len(across) == 1 == len(down):
        # Rays are linear in the position in the image, which begins in the first pixel.
        basis = np.linalg.inv(np.stack([directions[0], across[0], down[0]], axis=-1))
        found = points @ basis.T
        row, column = np.divmod(pixels, width)
        return found[..., 0], found[..., 1:] / found[..., :1] - np.stack([column, row], axis=-1)[:, None]
    # Most pixels contain several edges.
    own, of = np.unique(pixels, return_inverse=True)
    across, down = (item[own] if len(item) > 1 else np.broadcast_to(item, (len(own), 3)) for item in steps)
    basis = np.linalg.inv(np.stack([directions[own], across, down], axis=-1))[of]
    found = np.einsum("kij,kcj->kci", basis, points)
    return found[..., 0], found[..., 1:] / found[..., :1]


def _marked(
    caster: RayCaster,
    viewpoint: Viewpoint,
    camera: Camera,
    bodies: NDArray[np.int32],
    lines: SurfaceLines | None = None,
    changes: Changes | None = None,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], _Pieces]:
    """Return the mixed pixels, those of them without an edge, and the pieces of all edges."""
    mixed = np.zeros((camera.height, camera.width), dtype=np.bool_)
    edges = _contour_edges(caster, viewpoint.position_mm)
    ends = viewpoint.to_camera(caster.vertices_mm)[caster.topology.edges[edges]]
    faces = caster.topology.edge_faces[edges]
    if lines is not None:
        points = np.stack([lines.starts_mm, lines.ends_mm], axis=1)
        ends = np.concatenate([ends, viewpoint.to_camera(points.reshape(-1, 3)).reshape(-1, 2, 3)])
        faces = np.concatenate([faces, np.stack([lines.face, lines.face], axis=1)])
    inverse_depth, positions, directions, which = _cut_at_pixels(ends[:, 0], ends[:, 1], camera)
    seen = np.zeros(len(positions), dtype=np.bool_)
    if len(positions):
        columns, rows = _pixels_of(positions, mixed.shape)
        pixels, tested = rows * camera.width + columns, np.ones(len(positions), dtype=np.bool_)
        if lines is not None:
            # Where no pixel around shows the body, lines on it are hidden, or it is narrow: its edges cross the pixel.
            on_line = np.flatnonzero(which >= len(edges))
            own = lines.body[which[on_line] - len(edges)]
            tested[on_line] = _shows_near(bodies, columns[on_line], rows[on_line], own)
        order = np.argsort(np.where(tested, pixels, -1), kind="stable")[np.count_nonzero(~tested) :]
        rays = viewpoint.directions_to_world(directions[order])
        hits = caster.cast_in_pixels(viewpoint.position_mm, rays, pixels[order])
        depth = 1 / inverse_depth
        one, other = faces.T
        at_edge = (hits.face == one[which[order]]) | (hits.face == other[which[order]])
        seen[order] = at_edge | ~(hits.depth < depth[order] * (1 - _HIDDEN))
        if lines is not None and changes is not None:
            here = np.flatnonzero(seen & (which >= len(edges)))
            points = viewpoint.position_mm + viewpoint.directions_to_world(directions[here]) * depth[here, None]
            changed = changes(points, which[here] - len(edges), lines)
            # Where a line begins to be visible, its middle in the pixel may still be hidden.
            _mark(mixed, positions[here[changed]])
            near = _grown(mixed)
            columns, rows = _pixels_of(positions[here], mixed.shape)
            seen[here] = changed | near[rows, columns]
        _mark(mixed, positions[seen])
    bare = mixed.copy()
    _mark_unmarked_borders(mixed, bodies)
    np.not_equal(bare, mixed, out=bare)
    return mixed, bare, _Pieces(positions, which, seen, ends)


def _shows_near(
    bodies: NDArray[np.int32], columns: NDArray[np.int64], rows: NDArray[np.int64], body: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return whether a pixel or one of its neighbours shows a body at its centre."""
    padded, found = np.pad(bodies, 1, constant_values=-1).ravel(), np.zeros(len(body), dtype=np.bool_)
    width = bodies.shape[1] + 2
    centre = (rows + 1) * width + columns + 1
    for step in (-width - 1, -width, -width + 1, -1, 0, 1, width - 1, width, width + 1):
        found |= padded[centre + step] == body
    return found


def _pixels_of(positions: NDArray[np.float64], shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the column and the row of the pixels at image positions."""
    columns, rows = np.rint(positions).astype(np.int64).T
    return np.clip(columns, 0, shape[1] - 1), np.clip(rows, 0, shape[0] - 1)


def _grown(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the marked pixels with all their neighbours."""
    grown = pixels.copy()
    grown[1:] |= pixels[:-1]
    grown[:-1] |= pixels[1:]
    wide = grown.copy()
    wide[:, 1:] |= grown[:, :-1]
    wide[:, :-1] |= grown[:, 1:]
    return wide


def _mark(mixed: NDArray[np.bool_], positions: NDArray[np.float64]) -> None:
    """Mark the pixels at image positions; a line along a pixel border belongs to both pixels."""
    last_row, last_column = mixed.shape[0] - 1, mixed.shape[1] - 1
    nearest = np.rint(positions)
    columns, rows = nearest.astype(np.int64).T
    mixed[np.clip(rows, 0, last_row), np.clip(columns, 0, last_column)] = True
    # Few lines are near a pixel border.
    near = np.abs(positions - nearest) > 0.5 - 2 * _TOUCH_PX
    few = positions[near[:, 0] | near[:, 1]]
    for shift_x in (-_TOUCH_PX, _TOUCH_PX):
        for shift_y in (-_TOUCH_PX, _TOUCH_PX):
            columns = np.clip(np.rint(few[:, 0] + shift_x).astype(np.int64), 0, last_column)
            rows = np.clip(np.rint(few[:, 1] + shift_y).astype(np.int64), 0, last_row)
            mixed[rows, columns] = True


def _contour_edges(caster: RayCaster, origin_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    from scenetruth.raycast.edge_kernels import contour_edges

    topology = caster.topology
    normals, front = caster.sides(origin_mm)
    chosen: NDArray[np.bool_] = contour_edges(
        normals,
        front,
        topology.edge_faces,
        topology.edge_flipped,
        topology.edge_crowded,
        topology.edge_crease_cosine,
    )
    return np.flatnonzero(chosen)


def _cut_at_pixels(
    start: NDArray[np.float64], end: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Split segments at pixel borders (short pieces with distortion); return 1/Z, position, direction and segment."""
    from scenetruth.raycast.edge_kernels import cut_segments

    pinhole = camera.without_distortion()
    focal, centre = pinhole.focal_px, np.asarray(pinhole.principal_point)
    in_front = (start[:, 2] > _NEAR) | (end[:, 2] > _NEAR)
    which = np.flatnonzero(in_front)
    both = np.stack([start[which], end[which]], axis=1)
    _cut_in_front(both)
    start, end = both[:, 0], both[:, 1]
    first = focal * start[:, :2] / start[:, 2:] + centre
    last = focal * end[:, :2] / end[:, 2:] + centre
    inverse_first, inverse_last = 1 / start[:, 2], 1 / end[:, 2]
    low_corner, high_corner = _seen_rectangle(camera)
    keep, enter, leave = _clip(first, last - first, low_corner, high_corner)
    piece = 0.0 if camera.distortion is None else _PIECE_PX
    inverses, positions, segments = cut_segments(
        first, last, inverse_first, inverse_last, np.flatnonzero(keep), enter, leave, piece
    )
    segments = which[segments]
    directions = pinhole.ray_directions(positions)
    if camera.distortion is not None:
        positions = camera.project(directions)
        inside = ((positions >= -0.5) & (positions <= np.array([camera.width, camera.height]) - 0.5)).all(axis=1)
        inverses, positions, segments = inverses[inside], positions[inside], segments[inside]
        directions = directions[inside]
    return inverses, positions, directions, segments


def _cut_in_front(ends: NDArray[np.float64]) -> None:
    """Move the ends of segments, shape (n, 2, 3), that lie behind the camera to the near clipping depth, in place."""
    for one, other in ((ends[:, 0], ends[:, 1]), (ends[:, 1], ends[:, 0])):
        behind = one[:, 2] <= _NEAR
        share = (_NEAR - one[behind, 2]) / (other[behind, 2] - one[behind, 2])
        one[behind] += share[:, None] * (other[behind] - one[behind])


@lru_cache(maxsize=4096)
def _seen_rectangle(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners in px of the pinhole-image rectangle that covers the distorted image."""
    if camera.distortion is None:
        return np.full(2, -0.5), np.array([camera.width, camera.height]) - 0.5
    x, y = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 65), np.linspace(-0.5, camera.height - 0.5, 65))
    seen = camera.without_distortion().project(camera.ray_directions(np.stack([x, y], axis=-1).reshape(-1, 2)))
    return seen.min(axis=0) - 1.0, seen.max(axis=0) + 1.0


def _clip(
    first: NDArray[np.float64], step: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Clip segments to a rectangle (Liang and Barsky); return which remain and their entry and exit parameters."""
    enter, leave = np.zeros(len(first)), np.ones(len(first))
    keep = np.ones(len(first), dtype=np.bool_)
    for axis in range(2):
        parallel = step[:, axis] == 0
        safe = np.where(parallel, 1.0, step[:, axis])
        one, two = (low[axis] - first[:, axis]) / safe, (high[axis] - first[:, axis]) / safe
        enter = np.where(parallel, enter, np.maximum(enter, np.minimum(one, two)))
        leave = np.where(parallel, leave, np.minimum(leave, np.maximum(one, two)))
        keep &= ~parallel | ((first[:, axis] >= low[axis]) & (first[:, axis] <= high[axis]))
    return keep & (enter <= leave), enter, leave


def _mark_unmarked_borders(mixed: NDArray[np.bool_], bodies: NDArray[np.int32]) -> None:
    for one, two in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        bare = (bodies[one] != bodies[two]) & ~mixed[one] & ~mixed[two]
        mixed[one] |= bare
        mixed[two] |= bare

"""Kernels for the first hits of a grid of rays from one point, tile by tile in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.raycast.ray_triangle_kernels import (
    BLUR_X,
    BLUR_Y,
    BLUR_Z,
    DISTANCE,
    FORMS,
    HIGH_U,
    HIGH_V,
    LEAST_COSINE,
    LOW_U,
    LOW_V,
    PLANE_MARGIN,
    RANGES,
    W0_X,
    W1_X,
    W2_X,
    components,
    depth_on,
    edge_functions,
    inside,
    rounding,
    weigh,
    write_forms,
)
from scenetruth.threads import in_bands

__all__ = ["count_covered", "grid_hits", "grid_steps", "hits_on_faces", "prepare_faces", "raster_hits", "tile_bounds"]

TILE = 16
"""Side length of the square tiles in rays."""

# Corners closer to the plane through the origin normal to the axis than this fraction of their distance have no
# usable projection; their faces are tested against all rays.
_GRAZING = 1e-6
_BOX_MARGIN = 1e-8  # relative margin of the boxes; rounding is below 1e-9 even at `_GRAZING`
_SHORT = 4  # number of rays in a row that are all tested against a face
_GRID_MARGIN = 1e-6  # deviation of rays from a regular grid, in steps of the grid
_LEAST_BOUNDED, _LEAST_CAST = 8192, 2048  # minimum number of rays per thread


def tile_bounds(
    directions: NDArray[np.float64], width: int, frame: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Compute the bounds of every tile of rays in the central projection along an axis.

    ``directions``: Directions of a grid of rays in row-major order, shape (n, 3); NaN directions are skipped.
    Returns: Lowest u, highest u, lowest v, highest v of every tile, shape (tile rows, tile columns, 4); and whether all
    rays point into the half space of the axis.
    """
    height = directions.shape[0] // width
    rows, columns = (height + TILE - 1) // TILE, (width + TILE - 1) // TILE
    bounds = np.empty((rows, columns, RANGES), dtype=np.float64)
    forward = np.ones(rows, dtype=np.bool_)
    in_bands(_tile_bounds, rows, directions, width, frame, bounds, forward, least=_tile_rows(_LEAST_BOUNDED, width))
    return bounds, bool(forward.all())


def _tile_rows(rays: int, width: int) -> int:
    """Return the number of tile rows for a number of rays."""
    return max(rays // (TILE * width), 1)


@kernel()
def _tile_bounds(
    low: int, high: int, directions: NDArray[np.float64], width: int, frame: NDArray[np.float64],
    bounds: NDArray[np.float64], forward: NDArray[np.bool_],
) -> None:  # fmt: skip
    height = directions.shape[0] // width
    for row in range(low, high):
        for column in range(bounds.shape[1]):
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
            for y in range(row * TILE, min((row + 1) * TILE, height)):
                for x in range(column * TILE, min((column + 1) * TILE, width)):
                    dx, dy, dz = directions[y * width + x]
                    across, down, along = components(dx, dy, dz, frame)
                    if np.isnan(along):
                        continue
                    if along <= LEAST_COSINE * np.sqrt(dx * dx + dy * dy + dz * dz):
                        forward[row] = False
                        continue
                    u, v = across / along, down / along
                    low_u, high_u = min(low_u, u), max(high_u, u)
                    low_v, high_v = min(low_v, v), max(high_v, v)
            bounds[row, column, LOW_U], bounds[row, column, HIGH_U] = low_u, high_u
            bounds[row, column, LOW_V], bounds[row, column, HIGH_V] = low_v, high_v


def prepare_faces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    origin: NDArray[np.float64],
    frame: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Prepare all faces for rays from one point: edge functions and ranges in the projection.

    ``vertices``: World positions in mm, shape (n, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``origin``: Origin of the rays in mm, shape (3,).
    Returns: Coefficients of every face, see `write_forms`, shape (m, 16); and lowest u, highest u, lowest v, highest v
    with margins for rounding, shape (m, 4). The range of faces behind the origin is empty.
    """
    count = faces.shape[0]
    forms = np.empty((count, FORMS), dtype=np.float64)
    boxes = np.empty((count, RANGES), dtype=np.float64)
    in_bands(_prepare_faces, count, vertices, faces, origin, frame, forms, boxes)
    return forms, boxes


@kernel()
def _prepare_faces(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], origin: NDArray[np.float64],
    frame: NDArray[np.float64], forms: NDArray[np.float64], boxes: NDArray[np.float64],
) -> None:  # fmt: skip
    for face in range(low, high):
        low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        behind, grazing = True, False
        for corner in range(3):
            vertex = faces[face, corner]
            x, y, z = vertices[vertex, 0] - origin[0], vertices[vertex, 1] - origin[1], vertices[vertex, 2] - origin[2]
            across, down, along = components(x, y, z, frame)
            size = np.sqrt(x * x + y * y + z * z)
            if along > -PLANE_MARGIN * size:
                behind = False
            if along <= _GRAZING * size:
                grazing = True
                continue
            u, v = across / along, down / along
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
        if behind:
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        elif grazing:
            low_u, high_u, low_v, high_v = -np.inf, np.inf, -np.inf, np.inf
        else:
            margin_u = _BOX_MARGIN * (1.0 + max(abs(low_u), abs(high_u)))
            margin_v = _BOX_MARGIN * (1.0 + max(abs(low_v), abs(high_v)))
            low_u, high_u, low_v, high_v = low_u - margin_u, high_u + margin_u, low_v - margin_v, high_v + margin_v
        boxes[face, LOW_U], boxes[face, HIGH_U] = low_u, high_u
        boxes[face, LOW_V], boxes[face, HIGH_V] = low_v, high_v
        write_forms(vertices, faces, face, origin, forms[face])


@subkernel()
def _edges_of_tile(form: NDArray[np.float64], frame: NDArray[np.float64], bounds: NDArray[np.float64]) -> Any:
    """Return whether any ray of a tile may be inside the three edges of a face, and whether all rays certainly are."""
    may_positive, may_negative, all_positive, all_negative = True, True, True, True
    largest_u = max(abs(bounds[LOW_U]), abs(bounds[HIGH_U]))
    largest_v = max(abs(bounds[LOW_V]), abs(bounds[HIGH_V]))
    for first in (W0_X, W1_X, W2_X):
        nx, ny, nz = form[first], form[first + 1], form[first + 2]
        # The edge function divided by the ray component along the axis is linear in u and v.
        along_u, along_v, constant = components(nx, ny, nz, frame)
        blur = form[BLUR_X] + form[BLUR_Y] + form[BLUR_Z]
        margin = (PLANE_MARGIN * np.sqrt(nx * nx + ny * ny + nz * nz) + blur) * (1.0 + largest_u + largest_v)
        one_u, two_u = along_u * bounds[LOW_U], along_u * bounds[HIGH_U]
        one_v, two_v = along_v * bounds[LOW_V], along_v * bounds[HIGH_V]
        lowest = min(one_u, two_u) + min(one_v, two_v) + constant - margin
        highest = max(one_u, two_u) + max(one_v, two_v) + constant + margin
        may_positive, may_negative = may_positive and highest >= 0.0, may_negative and lowest <= 0.0
        all_positive, all_negative = all_positive and lowest > 0.0, all_negative and highest < 0.0
    return may_positive or may_negative, all_positive or all_negative


def raster_hits(
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    frame: NDArray[np.float64],
    bounds: NDArray[np.float64],
    directions: NDArray[np.float64],
    width: int,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the first hit of every ray of a grid, tile by tile.

    Every face is tested against all rays of the tiles that it may touch, by the signs of its three edge functions. The
    nearest face is taken, for equal depth the face with the lower index.

    ``directions``: Directions of the rays in row-major order, shape (n, 3).
    """
    count = directions.shape[0]
    face = np.empty(count, dtype=np.int32)
    depth = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    arguments = (forms, boxes, frame, bounds, directions, width, face, depth, weights)
    in_bands(_raster_hits, bounds.shape[0], *arguments, least=_tile_rows(_LEAST_CAST, width))
    return face, depth, weights


@subkernel()
def _weigh_hits(
    first: int, last: int, forms: NDArray[np.float64], directions: NDArray[np.float64], face: NDArray[np.int32],
    depth: NDArray[np.float64], weights: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write the weights of the corners where rays hit a face; rays without a hit have the depth NaN."""
    for n in range(first, last):
        if face[n] < 0:
            depth[n], weights[n, 0], weights[n, 1] = np.nan, 0.0, 0.0
            continue
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        weights[n, 0], weights[n, 1] = weigh(forms[face[n]], dx, dy, dz)


@kernel()
def _raster_hits(
    low: int, high: int, forms: NDArray[np.float64], boxes: NDArray[np.float64], frame: NDArray[np.float64],
    bounds: NDArray[np.float64], directions: NDArray[np.float64], width: int, face_out: NDArray[np.int32],
    depth_out: NDArray[np.float64], weights: NDArray[np.float64],
) -> None:  # fmt: skip
    height = directions.shape[0] // width
    rows, columns = bounds.shape[0], bounds.shape[1]
    half = (rows + 1) // 2
    for turn in range(low, high):
        # Even tile rows first, then odd rows, to balance the load of the threads.
        row = 2 * turn if turn < half else 2 * (turn - half) + 1
        top, bottom = row * TILE, min((row + 1) * TILE, height)
        for n in range(top * width, bottom * width):
            face_out[n], depth_out[n] = -1, np.inf
        row_low, row_high = bounds[row, :, LOW_V].min(), bounds[row, :, HIGH_V].max()
        for face in range(forms.shape[0]):
            if boxes[face, LOW_V] > row_high or boxes[face, HIGH_V] < row_low:
                continue
            form = forms[face]
            for column in range(columns):
                tile = bounds[row, column]
                if boxes[face, LOW_U] > tile[HIGH_U] or boxes[face, HIGH_U] < tile[LOW_U]:
                    continue
                if boxes[face, LOW_V] > tile[HIGH_V] or boxes[face, HIGH_V] < tile[LOW_V]:
                    continue
                possible, certain = _edges_of_tile(form, frame, tile)
                if not possible:
                    continue
                left, right = column * TILE, min((column + 1) * TILE, width)
                for y in range(top, bottom):
                    for n in range(y * width + left, y * width + right):
                        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
                        if not certain:
                            w0, w1, w2 = edge_functions(form, dx, dy, dz)
                            if not inside(w0, w1, w2, rounding(form, dx, dy, dz)):
                                continue
                        depth = depth_on(form, dx, dy, dz)
                        if depth > 0.0 and depth < depth_out[n]:
                            face_out[n], depth_out[n] = face, depth
        _weigh_hits(top * width, bottom * width, forms, directions, face_out, depth_out, weights)


def hits_on_faces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    face: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute depth and weights where rays hit given faces, -1 for none; bit-identical to `raster_hits`."""
    count = directions.shape[0]
    depth, weights = np.empty(count, dtype=np.float64), np.empty((count, 2), dtype=np.float64)
    in_bands(_hits_on_faces, count, vertices, faces, origin, directions, face, depth, weights, least=_LEAST_CAST)
    return depth, weights


@kernel()
def _hits_on_faces(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], origin: NDArray[np.float64],
    directions: NDArray[np.float64], face: NDArray[np.int32], depth: NDArray[np.float64], weights: NDArray[np.float64],
) -> None:  # fmt: skip
    form, ready = np.empty(FORMS, dtype=np.float64), np.int64(-1)
    for n in range(low, high):
        if face[n] < 0:
            depth[n], weights[n, 0], weights[n, 1] = np.nan, 0.0, 0.0
            continue
        if face[n] != ready:
            ready = np.int64(face[n])
            write_forms(vertices, faces, ready, origin, form)
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        depth[n] = depth_on(form, dx, dy, dz)
        weights[n, 0], weights[n, 1] = weigh(form, dx, dy, dz)


def grid_steps(
    directions: NDArray[np.float64], width: int, frame: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Compute the positions of a regular grid of rays in the central projection along an axis.

    Returns: Lowest u, step of u from column to column, lowest v, and step of v from row to row, shape (4,); and whether
    all rays are on this grid, within `_GRID_MARGIN` steps, and point into the half space of the axis.
    """
    height = directions.shape[0] // width
    grid = np.empty(4, dtype=np.float64)
    for axis, last in enumerate((width - 1, (height - 1) * width)):
        ends = directions[[0, last]] @ frame.T
        places = ends[:, axis] / ends[:, 2]
        grid[2 * axis] = places[0]
        grid[2 * axis + 1] = (places[1] - places[0]) / (width - 1 if axis == 0 else height - 1)
    regular = np.empty(height, dtype=np.bool_)
    least = -(-_LEAST_BOUNDED // width)
    in_bands(_grid_steps, height, directions, width, frame, grid, regular, least=least)
    return grid, bool(regular.all())


@kernel()
def _grid_steps(
    low: int, high: int, directions: NDArray[np.float64], width: int, frame: NDArray[np.float64],
    grid: NDArray[np.float64], regular: NDArray[np.bool_],
) -> None:  # fmt: skip
    apart_u, apart_v = _GRID_MARGIN * abs(grid[1]), _GRID_MARGIN * abs(grid[3])
    first_u, step_u = grid[0], grid[1]
    for y in range(np.uint64(low), np.uint64(high)):
        good, v = 0, grid[2] + y * grid[3]
        for x in range(np.uint64(width)):
            n = y * np.uint64(width) + x
            dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
            across, down, along = components(dx, dy, dz, frame)
            # Without divisions, roots and branches, in vectors. Comparisons with NaN are false.
            ahead = (along > 0.0) & (along * along > LEAST_COSINE**2 * (dx * dx + dy * dy + dz * dz))
            near_u = abs(across - (first_u + x * step_u) * along) < apart_u * along
            near_v = abs(down - v * along) < apart_v * along
            good += ahead & near_u & near_v
        regular[y] = good == width


@kernel()
def count_covered(boxes: NDArray[np.float64], grid: NDArray[np.float64], width: int, height: int) -> float:
    """Return the areas of the boxes of faces inside a regular grid of rays, in all, in steps of the grid."""
    total = 0.0
    for face in range(boxes.shape[0]):
        # Empty boxes, of faces behind the origin, end before they begin.
        if not boxes[face, LOW_U] <= boxes[face, HIGH_U]:
            continue
        # Infinite boxes, of faces close to the plane of the origin, cover the grid.
        one = min(max((boxes[face, LOW_U] - grid[0]) / grid[1], 0.0), float(width))
        other = min(max((boxes[face, HIGH_U] - grid[0]) / grid[1], 0.0), float(width))
        top = min(max((boxes[face, LOW_V] - grid[2]) / grid[3], 0.0), float(height))
        bottom = min(max((boxes[face, HIGH_V] - grid[2]) / grid[3], 0.0), float(height))
        total += abs(other - one) * abs(bottom - top)
    return total


def grid_hits(
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    grid: NDArray[np.float64],
    directions: NDArray[np.float64],
    width: int,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the first hit of every ray of a regular grid, face by face.

    As `raster_hits`, but every face is tested against the rays within its box, see `grid_steps`.
    """
    count = directions.shape[0]
    face = np.empty(count, dtype=np.int32)
    depth = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    arguments = (forms, boxes, grid, directions, width, face, depth, weights)
    in_bands(_grid_hits, count // width, *arguments, least=-(-_LEAST_CAST // width))
    return face, depth, weights


@inlined
def _covered(one: float, other: float, low: float, step: float, first: int, last: int) -> Any:
    """Return the first and last + 1 of the grid lines between two places, within a range."""
    start, end, least, most = (one - low) / step, (other - low) / step, float(first), float(last)
    start, end = min(start, end) - 2.0 * _GRID_MARGIN, max(start, end) + 2.0 * _GRID_MARGIN
    return int(np.ceil(min(max(start, least), most))), int(np.floor(min(max(end, least - 1.0), most - 1.0))) + 1


@subkernel()
def _between_edges(
    form: NDArray[np.float64], directions: NDArray[np.float64], start: int, width: int, left: int, right: int
) -> Any:  # fmt: skip
    """Return the first and last + 1 of the columns from ``left`` to ``right`` whose rays may be inside the edges.

    Edge functions are linear in the column; ``start`` is the ray of the first column. Margins cover rounding and the
    deviation of rays from the grid.
    """
    distance = form[DISTANCE]
    if distance == 0.0:
        return left, right
    side = 1.0 if distance > 0.0 else -1.0
    dx, dy, dz = directions[start, 0], directions[start, 1], directions[start, 2]
    ax, ay, az = (
        directions[1, 0] - directions[0, 0],
        directions[1, 1] - directions[0, 1],
        directions[1, 2] - directions[0, 2],
    )
    bx, by, bz = (
        directions[width, 0] - directions[0, 0],
        directions[width, 1] - directions[0, 1],
        directions[width, 2] - directions[0, 2],
    )
    blur = 4.0 * rounding(form, abs(dx) + width * abs(ax), abs(dy) + width * abs(ay), abs(dz) + width * abs(az))
    low, high = 0.0, right - left - 1.0
    for k in (W0_X, W1_X, W2_X):
        value = side * (form[k] * dx + form[k + 1] * dy + form[k + 2] * dz)
        step = side * (form[k] * ax + form[k + 1] * ay + form[k + 2] * az)
        below = form[k] * bx + form[k + 1] * by + form[k + 2] * bz
        value += blur + 8.0 * _GRID_MARGIN * (abs(step) + abs(below))
        if step > 0.0:
            low = max(low, -value / step)
        elif step < 0.0:
            high = min(high, -value / step)
        elif value < 0.0:
            return left, left
    if not low <= high:
        return left, left
    return left + int(np.ceil(low)), left + int(np.floor(high)) + 1


@kernel()
def _grid_hits(
    low: int, high: int, forms: NDArray[np.float64], boxes: NDArray[np.float64], grid: NDArray[np.float64],
    directions: NDArray[np.float64], width: int, face_out: NDArray[np.int32], depth_out: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(low * width, high * width):
        face_out[n], depth_out[n] = -1, np.inf
    for face in range(forms.shape[0]):
        if not boxes[face, LOW_V] <= boxes[face, HIGH_V]:
            continue
        top, bottom = _covered(boxes[face, LOW_V], boxes[face, HIGH_V], grid[2], grid[3], low, high)
        if top >= bottom:
            continue
        left, right = _covered(boxes[face, LOW_U], boxes[face, HIGH_U], grid[0], grid[1], 0, width)
        if left >= right:
            continue
        form = forms[face]
        # Copies, because the compiler cannot know that the output is other memory.
        w0_x, w0_y, w0_z = form[W0_X], form[W0_X + 1], form[W0_X + 2]
        w1_x, w1_y, w1_z = form[W1_X], form[W1_X + 1], form[W1_X + 2]
        w2_x, w2_y, w2_z = form[W2_X], form[W2_X + 1], form[W2_X + 2]
        blur_x, blur_y, blur_z = form[BLUR_X], form[BLUR_Y], form[BLUR_Z]
        for y in range(top, bottom):
            first, last = left, right
            if right - left > _SHORT:
                first, last = _between_edges(form, directions, y * width + left, width, left, right)
            for n in range(y * width + first, y * width + last):
                dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
                w0 = dx * w0_x + dy * w0_y + dz * w0_z
                w1 = dx * w1_x + dy * w1_y + dz * w1_z
                w2 = dx * w2_x + dy * w2_y + dz * w2_z
                if not inside(w0, w1, w2, abs(dx) * blur_x + abs(dy) * blur_y + abs(dz) * blur_z):
                    continue
                depth = depth_on(form, dx, dy, dz)
                if depth > 0.0 and depth < depth_out[n]:
                    face_out[n], depth_out[n] = face, depth
    _weigh_hits(low * width, high * width, forms, directions, face_out, depth_out, weights)

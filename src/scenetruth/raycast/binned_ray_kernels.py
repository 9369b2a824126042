"""Kernels for the first hits of rays from one point, binned into square cells, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.raycast.ray_triangle_kernels import (
    BLUR_X,
    BLUR_Y,
    BLUR_Z,
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
    within,
)
from scenetruth.threads import in_bands

__all__ = ["bin_faces", "scatter_hits", "sort_rays"]

# A ray field holds the ranges of u and v, followed by the number of cells per unit of u and v.
_CELLS_PER_U, _CELLS_PER_V = RANGES, RANGES + 1
_SHARES = 64  # number of shares of faces sorted in parallel
_MANY = 16  # faces that may touch more rays of a row than this are intersected with the row
_RUN = 64  # number of rays tested per batch
_ROW_MARGIN = 1e-6  # relative tolerance by which rays may exceed their row of cells due to rounding
# Minimum number of faces, projected rays and cast rays per thread.
_LEAST_SORTED, _LEAST_PROJECTED, _LEAST_CAST = 4096, 8192, 1024


@inlined
def _cell(value: float, low: float, per_cell: float, last: int) -> Any:
    """Return the cell of a coordinate, from 0 to ``last``, monotonic in the coordinate."""
    return int(min(max((value - low) * per_cell, 0.0), last + 0.0))


def sort_rays(
    directions: NDArray[np.float64], frame: NDArray[np.float64], side: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], bool]:
    """Sort rays into square cells of the central projection along an axis.

    ``directions``: Directions of the rays, shape (n, 3).
    Returns: Ray indices in row-major cell order, NaN rays last, shape (n,); start index of each cell, shape (side *
    side + 1,); ray field: lowest u, highest u, lowest v, highest v, cells per unit of u and of v, shape (6,); and
    whether all rays point into the half space of the axis.
    """
    count = directions.shape[0]
    places = np.empty((count, 2), dtype=np.float64)
    forward = np.empty(count, dtype=np.bool_)
    in_bands(_project, count, directions, frame, places, forward, least=_LEAST_PROJECTED)
    order, start, field = _sort_places(places, side)
    return order, start, field, bool(forward.all())


@kernel()
def _project(
    low: int, high: int, directions: NDArray[np.float64], frame: NDArray[np.float64], places: NDArray[np.float64],
    forward: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write the projections u and v of rays, and whether they point into the half space of the axis."""
    for n in range(low, high):
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        across, down, along = components(dx, dy, dz, frame)
        # NaN directions are skipped.
        forward[n] = not along <= LEAST_COSINE * np.sqrt(dx * dx + dy * dy + dz * dz)
        places[n, 0], places[n, 1] = across / along, down / along


@kernel()
def _sort_places(places: NDArray[np.float64], side: int) -> Any:
    """Return the ray order, cell starts and ray field, see `sort_rays`."""
    count = places.shape[0]
    field = np.array([np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0])
    for n in range(count):
        # Comparisons with NaN are false.
        for axis in range(2):
            if places[n, axis] < field[LOW_U + 2 * axis]:
                field[LOW_U + 2 * axis] = places[n, axis]
            if places[n, axis] > field[HIGH_U + 2 * axis]:
                field[HIGH_U + 2 * axis] = places[n, axis]
    for axis in range(2):
        extent = field[HIGH_U + 2 * axis] - field[LOW_U + 2 * axis]
        field[_CELLS_PER_U + axis] = side / extent if extent > 0.0 else 0.0
    cells = side * side
    start = np.zeros(cells + 2, dtype=np.int64)
    cell_of = np.empty(count, dtype=np.int32)
    for n in range(count):
        cell_of[n] = cells
        if not np.isnan(places[n, 0] + places[n, 1]):
            row = _cell(places[n, 1], field[LOW_V], field[_CELLS_PER_V], side - 1)
            cell_of[n] = row * side + _cell(places[n, 0], field[LOW_U], field[_CELLS_PER_U], side - 1)
        start[cell_of[n] + 1] += 1
    for cell in range(cells + 1):
        start[cell + 1] += start[cell]
    order = np.empty(count, dtype=np.int64)
    used = start[:-1].copy()
    for n in range(count):
        order[used[cell_of[n]]] = n
        used[cell_of[n]] += 1
    return order, start[: cells + 1], field


def bin_faces(
    boxes: NDArray[np.float64], field: NDArray[np.float64], side: int, most: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """List the faces that may touch each row of cells (empty above ``most``); return the list and its row starts."""
    used = np.zeros((_SHARES, side), dtype=np.int64)
    least = max(_SHARES * _LEAST_SORTED // max(boxes.shape[0], 1), 1)
    in_bands(_count_faces, _SHARES, boxes, field, used, least=least)
    # The entries of a row, share after share, keep the order of the faces.
    ends = np.cumsum(used.T)
    start = np.zeros(side + 1, dtype=np.int64)
    start[1:] = ends[_SHARES - 1 :: _SHARES]
    if start[side] > most:
        return np.empty(0, dtype=np.int32), start
    used[:] = ends.reshape(side, _SHARES).T - used
    listed = np.empty(start[side], dtype=np.int32)
    in_bands(_list_faces, _SHARES, boxes, field, used, listed, least=least)
    return listed, start


@kernel()
def _count_faces(
    low: int, high: int, boxes: NDArray[np.float64], field: NDArray[np.float64], used: NDArray[np.int64]
) -> None:
    count, side = boxes.shape[0], used.shape[1]
    per_share = (count + _SHARES - 1) // _SHARES
    for share in range(low, high):
        for face in range(share * per_share, min((share + 1) * per_share, count)):
            if _outside(boxes[face], field):
                continue
            first = _cell(boxes[face, LOW_V], field[LOW_V], field[_CELLS_PER_V], side - 1)
            for row in range(first, _cell(boxes[face, HIGH_V], field[LOW_V], field[_CELLS_PER_V], side - 1) + 1):
                used[share, row] += 1


@kernel()
def _list_faces(
    low: int, high: int, boxes: NDArray[np.float64], field: NDArray[np.float64], used: NDArray[np.int64],
    listed: NDArray[np.int32],
) -> None:  # fmt: skip
    count, side = boxes.shape[0], used.shape[1]
    per_share = (count + _SHARES - 1) // _SHARES
    for share in range(low, high):
        for face in range(share * per_share, min((share + 1) * per_share, count)):
            if _outside(boxes[face], field):
                continue
            first = _cell(boxes[face, LOW_V], field[LOW_V], field[_CELLS_PER_V], side - 1)
            for row in range(first, _cell(boxes[face, HIGH_V], field[LOW_V], field[_CELLS_PER_V], side - 1) + 1):
                listed[used[share, row]] = face
                used[share, row] += 1


@inlined
def _outside(box: NDArray[np.float64], field: NDArray[np.float64]) -> Any:
    """Return whether a face touches no ray."""
    return not (
        box[LOW_U] <= field[HIGH_U]
        and box[HIGH_U] >= field[LOW_U]
        and box[LOW_V] <= field[HIGH_V]
        and box[HIGH_V] >= field[LOW_V]
    )


@subkernel()
def _reach_in_row(
    form: NDArray[np.float64],
    frame: NDArray[np.float64],
    field: NDArray[np.float64],
    low_v: float,
    high_v: float,
) -> Any:
    """Return bounds of u for rays inside a face with v in a range, with margins for rounding."""
    largest = 1.0 + max(abs(field[LOW_U]), abs(field[HIGH_U])) + max(abs(field[LOW_V]), abs(field[HIGH_V]))
    blur = form[BLUR_X] + form[BLUR_Y] + form[BLUR_Z]
    reach_low, reach_high = np.inf, -np.inf
    for sign in (1.0, -1.0):
        low, high = -np.inf, np.inf
        for first in (W0_X, W1_X, W2_X):
            nx, ny, nz = form[first], form[first + 1], form[first + 2]
            along_u, along_v, constant = components(nx, ny, nz, frame)
            margin = (PLANE_MARGIN * np.sqrt(nx * nx + ny * ny + nz * nz) + blur) * largest
            low, high = within(sign * along_u, sign * along_v, sign * constant, margin, low_v, high_v, low, high)
        if low <= high:
            reach_low, reach_high = min(reach_low, low), max(reach_high, high)
    return reach_low, reach_high


def scatter_hits(
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    frame: NDArray[np.float64],
    field: NDArray[np.float64],
    side: int,
    directions: NDArray[np.float64],
    order: NDArray[np.int64],
    cell_start: NDArray[np.int64],
    listed: NDArray[np.int32],
    row_start: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the first hit of every ray, cell by cell; bit-identical to `raster_hits`."""
    count = directions.shape[0]
    face = np.empty(count, dtype=np.int32)
    depth = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    rays, lists, out = (directions, order, cell_start), (listed, row_start), (face, depth, weights)
    least = max(side * _LEAST_CAST // max(count, 1), 1)
    in_bands(_scatter_hits, side, forms, boxes, frame, field, side, rays, lists, out, least=least)
    lost = order[cell_start[-1] :]
    face[lost], depth[lost], weights[lost] = -1, np.nan, 0.0
    return face, depth, weights


@kernel()
def _scatter_hits(
    low_turn: int, high_turn: int, forms: NDArray[np.float64], boxes: NDArray[np.float64], frame: NDArray[np.float64],
    field: NDArray[np.float64], side: int, rays: tuple[NDArray[Any], ...], lists: tuple[NDArray[Any], ...],
    out: tuple[NDArray[Any], ...],
) -> None:  # fmt: skip
    directions, order, cell_start = rays
    listed, row_start = lists
    face_out, depth_out, weights = out
    possible = np.empty(_RUN, dtype=np.bool_)
    for turn in range(low_turn, high_turn):
        # Interleave distant rows (``side`` is a power of two) to balance the load of the threads.
        row = (turn * (5 * side // 8 | 1)) % side
        first, behind = cell_start[row * side], cell_start[(row + 1) * side]
        here = behind - first
        xs, ys, zs = np.empty(here), np.empty(here), np.empty(here)
        for n in range(here):
            ray = order[first + n]
            xs[n], ys[n], zs[n] = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        low_v, high_v = field[LOW_V], field[HIGH_V]
        if field[_CELLS_PER_V] > 0.0:
            high_v = low_v + (row + 1 + _ROW_MARGIN) / field[_CELLS_PER_V]
            low_v += (row - _ROW_MARGIN) / field[_CELLS_PER_V]
        best = np.full(here, -1, dtype=np.int32)
        nearest = np.full(here, np.inf)
        faces_here = range(row_start[row], row_start[row + 1]) if here > 0 else range(0)
        for entry in faces_here:
            face = listed[entry]
            left = _cell(boxes[face, LOW_U], field[LOW_U], field[_CELLS_PER_U], side - 1)
            right = _cell(boxes[face, HIGH_U], field[LOW_U], field[_CELLS_PER_U], side - 1)
            low, high = cell_start[row * side + left] - first, cell_start[row * side + right + 1] - first
            form = forms[face]
            if high - low > _MANY:
                # Long oblique faces touch only a part of the cells of their bounding box.
                reach_low, reach_high = _reach_in_row(form, frame, field, low_v, high_v)
                if not reach_low <= reach_high:
                    continue
                left = max(left, _cell(reach_low, field[LOW_U], field[_CELLS_PER_U], side - 1))
                right = min(right, _cell(reach_high, field[LOW_U], field[_CELLS_PER_U], side - 1))
                low, high = cell_start[row * side + left] - first, cell_start[row * side + right + 1] - first
            w0_x, w0_y, w0_z = form[W0_X], form[W0_X + 1], form[W0_X + 2]
            w1_x, w1_y, w1_z = form[W1_X], form[W1_X + 1], form[W1_X + 2]
            w2_x, w2_y, w2_z = form[W2_X], form[W2_X + 1], form[W2_X + 2]
            blur_x, blur_y, blur_z = form[BLUR_X], form[BLUR_Y], form[BLUR_Z]
            for part in range(low, high, _RUN):
                # Reject rays that cannot be inside first; this loop is vectorised.
                size = min(_RUN, high - part)
                for m in range(size):
                    dx, dy, dz = xs[part + m], ys[part + m], zs[part + m]
                    w0 = dx * w0_x + dy * w0_y + dz * w0_z
                    w1 = dx * w1_x + dy * w1_y + dz * w1_z
                    w2 = dx * w2_x + dy * w2_y + dz * w2_z
                    blur = abs(dx) * blur_x + abs(dy) * blur_y + abs(dz) * blur_z
                    positive = (w0 >= -blur) & (w1 >= -blur) & (w2 >= -blur)
                    negative = (w0 <= blur) & (w1 <= blur) & (w2 <= blur)
                    possible[m] = positive | negative
                for m in range(size):
                    if not possible[m]:
                        continue
                    n = part + m
                    dx, dy, dz = xs[n], ys[n], zs[n]
                    w0, w1, w2 = edge_functions(form, dx, dy, dz)
                    if not inside(w0, w1, w2, rounding(form, dx, dy, dz)):
                        continue
                    depth = depth_on(form, dx, dy, dz)
                    if depth > 0.0 and depth < nearest[n]:
                        best[n], nearest[n] = face, depth
        for n in range(here):
            ray = order[first + n]
            face_out[ray], depth_out[ray] = best[n], nearest[n]
            if best[n] < 0:
                depth_out[ray], weights[ray, 0], weights[ray, 1] = np.nan, 0.0, 0.0
                continue
            weights[ray, 0], weights[ray, 1] = weigh(forms[best[n]], xs[n], ys[n], zs[n])

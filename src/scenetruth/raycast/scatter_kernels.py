"""Kernels that find what many rays from one point meet first among many small faces: in float64, cell by cell."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.inside_kernels import (
    BLUR_X,
    BLUR_Y,
    BLUR_Z,
    DISTANCE,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    W0_X,
    W0_Y,
    W0_Z,
    W1_X,
    W1_Y,
    W1_Z,
    W2_X,
    W2_Y,
    W2_Z,
    inside,
    weigh,
)

__all__ = ["bin_faces", "scatter_hits", "sort_rays"]

_LEAST_COSINE = 0.05  # as of `raster_kernels.tile_bounds`
# What a field or a box says of the projection's coordinates u and v: their ranges, and a field its cells besides.
_LOW_U, _HIGH_U, _LOW_V, _HIGH_V, _CELLS_PER_U, _CELLS_PER_V = range(6)
# Faces are sorted in so many shares side by side.
_SHARES = 64


@numba.njit(cache=True, nogil=True, inline="always")
def _cell(value: float, low: float, per_cell: float, last: int) -> Any:
    """Return the cell of a coordinate; a larger coordinate never has a lower cell."""
    return int(min(max((value - low) * per_cell, 0.0), last + 0.0))


@numba.njit(cache=True, nogil=True, parallel=True)
def sort_rays(directions: NDArray[np.float64], frame: NDArray[np.float64], side: int) -> Any:
    """Sort rays into ``side`` x ``side`` cells of the central projection along an axis.

    ``frame`` has two directions across and the axis as its rows. Returns the rays in the order of their cells, row by
    row, those that are NaN last; where each cell begins, shape (side * side + 1,); (lowest u, highest u, lowest v,
    highest v, cells per u, cells per v); and whether all rays point along the axis.
    """
    count = directions.shape[0]
    places = np.empty((count, 2), dtype=np.float64)
    backward = 0
    for n in numba.prange(count):
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        along = dx * frame[2, 0] + dy * frame[2, 1] + dz * frame[2, 2]
        if along <= _LEAST_COSINE * np.sqrt(dx * dx + dy * dy + dz * dz):
            backward += 1
        places[n, 0] = (dx * frame[0, 0] + dy * frame[0, 1] + dz * frame[0, 2]) / along
        places[n, 1] = (dx * frame[1, 0] + dy * frame[1, 1] + dz * frame[1, 2]) / along
    field = np.array([np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0])
    for n in range(count):
        # Comparisons with NaN are false.
        for axis in range(2):
            if places[n, axis] < field[_LOW_U + 2 * axis]:
                field[_LOW_U + 2 * axis] = places[n, axis]
            if places[n, axis] > field[_HIGH_U + 2 * axis]:
                field[_HIGH_U + 2 * axis] = places[n, axis]
    for axis in range(2):
        extent = field[_HIGH_U + 2 * axis] - field[_LOW_U + 2 * axis]
        field[_CELLS_PER_U + axis] = side / extent if extent > 0.0 else 0.0
    cells = side * side
    start = np.zeros(cells + 2, dtype=np.int64)
    cell_of = np.empty(count, dtype=np.int32)
    for n in range(count):
        cell_of[n] = cells
        if not np.isnan(places[n, 0] + places[n, 1]):
            row = _cell(places[n, 1], field[_LOW_V], field[_CELLS_PER_V], side - 1)
            cell_of[n] = row * side + _cell(places[n, 0], field[_LOW_U], field[_CELLS_PER_U], side - 1)
        start[cell_of[n] + 1] += 1
    for cell in range(cells + 1):
        start[cell + 1] += start[cell]
    order = np.empty(count, dtype=np.int64)
    used = start[:-1].copy()
    for n in range(count):
        order[used[cell_of[n]]] = n
        used[cell_of[n]] += 1
    return order, start[: cells + 1], field, backward == 0


@numba.njit(cache=True, nogil=True, parallel=True)
def bin_faces(boxes: NDArray[np.float64], field: NDArray[np.float64], side: int, most: int) -> Any:
    """List the faces that may touch each row of cells, in the order of their indices.

    ``boxes`` are those of `prepare_faces`, ``field`` that of `sort_rays`. Returns the faces, row after row, and where
    each row begins, shape (side + 1,); if there are more than ``most`` entries, no faces.
    """
    count = boxes.shape[0]
    per_share = (count + _SHARES - 1) // _SHARES
    used = np.zeros((_SHARES, side), dtype=np.int64)
    for share in numba.prange(_SHARES):
        for face in range(share * per_share, min((share + 1) * per_share, count)):
            if _outside(boxes[face], field):
                continue
            first = _cell(boxes[face, _LOW_V], field[_LOW_V], field[_CELLS_PER_V], side - 1)
            for row in range(first, _cell(boxes[face, _HIGH_V], field[_LOW_V], field[_CELLS_PER_V], side - 1) + 1):
                used[share, row] += 1
    start = np.zeros(side + 1, dtype=np.int64)
    for row in range(side):
        total = start[row]
        for share in range(_SHARES):
            entries = used[share, row]
            used[share, row] = total
            total += entries
        start[row + 1] = total
    if start[side] > most:
        return np.empty(0, dtype=np.int32), start
    listed = np.empty(start[side], dtype=np.int32)
    for share in numba.prange(_SHARES):
        for face in range(share * per_share, min((share + 1) * per_share, count)):
            if _outside(boxes[face], field):
                continue
            first = _cell(boxes[face, _LOW_V], field[_LOW_V], field[_CELLS_PER_V], side - 1)
            for row in range(first, _cell(boxes[face, _HIGH_V], field[_LOW_V], field[_CELLS_PER_V], side - 1) + 1):
                listed[used[share, row]] = face
                used[share, row] += 1
    return listed, start


@numba.njit(cache=True, nogil=True, inline="always")
def _outside(box: NDArray[np.float64], field: NDArray[np.float64]) -> Any:
    """Tell whether a face touches no ray at all."""
    return not (
        box[_LOW_U] <= field[_HIGH_U]
        and box[_HIGH_U] >= field[_LOW_U]
        and box[_LOW_V] <= field[_HIGH_V]
        and box[_HIGH_V] >= field[_LOW_V]
    )


@numba.njit(cache=True, nogil=True, parallel=True)
def scatter_hits(
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    field: NDArray[np.float64],
    side: int,
    directions: NDArray[np.float64],
    order: NDArray[np.int64],
    cell_start: NDArray[np.int64],
    listed: NDArray[np.int32],
    row_start: NDArray[np.int64],
) -> Any:
    """Find the first face, depth and barycentric coordinates of every ray, to the bit as `raster_hits`.

    ``forms`` and ``boxes`` are those of `prepare_faces`; ``order``, ``cell_start`` and ``field`` those of `sort_rays`;
    ``listed`` and ``row_start`` those of `bin_faces`.
    """
    count = directions.shape[0]
    face_out = np.empty(count, dtype=np.int32)
    depth_out = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    for turn in numba.prange(side):
        # Rows far apart one after the other (``side`` is a power of two): threads get shares that cost alike.
        row = (turn * (5 * side // 8 | 1)) % side
        first, behind = cell_start[row * side], cell_start[(row + 1) * side]
        rays = directions[order[first:behind]]
        best = np.full(behind - first, -1, dtype=np.int32)
        nearest = np.full(behind - first, np.inf)
        faces_here = range(row_start[row], row_start[row + 1]) if behind > first else range(0)
        for entry in faces_here:
            face = listed[entry]
            left = _cell(boxes[face, _LOW_U], field[_LOW_U], field[_CELLS_PER_U], side - 1)
            right = _cell(boxes[face, _HIGH_U], field[_LOW_U], field[_CELLS_PER_U], side - 1)
            low, high = cell_start[row * side + left] - first, cell_start[row * side + right + 1] - first
            form = forms[face]
            for n in range(low, high):
                dx, dy, dz = rays[n, 0], rays[n, 1], rays[n, 2]
                w2 = dx * form[W2_X] + dy * form[W2_Y] + dz * form[W2_Z]
                w0 = dx * form[W0_X] + dy * form[W0_Y] + dz * form[W0_Z]
                w1 = dx * form[W1_X] + dy * form[W1_Y] + dz * form[W1_Z]
                if not inside(w0, w1, w2, abs(dx) * form[BLUR_X] + abs(dy) * form[BLUR_Y] + abs(dz) * form[BLUR_Z]):
                    continue
                slope = form[NORMAL_X] * dx + form[NORMAL_Y] * dy + form[NORMAL_Z] * dz
                if slope == 0.0:
                    continue
                depth = form[DISTANCE] / slope
                if depth > 0.0 and depth < nearest[n]:
                    best[n], nearest[n] = face, depth
        for n in range(behind - first):
            ray = order[first + n]
            face_out[ray], depth_out[ray] = best[n], nearest[n]
            if best[n] < 0:
                depth_out[ray], weights[ray, 0], weights[ray, 1] = np.nan, 0.0, 0.0
                continue
            weights[ray, 0], weights[ray, 1] = weigh(forms[best[n]], rays[n, 0], rays[n, 1], rays[n, 2])
    for n in range(cell_start[side * side], count):
        ray = order[n]
        face_out[ray], depth_out[ray], weights[ray, 0], weights[ray, 1] = -1, np.nan, 0.0, 0.0
    return face_out, depth_out, weights

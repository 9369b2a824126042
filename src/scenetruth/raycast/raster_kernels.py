"""Kernels that find what a grid of rays from one point meets first, face by face in float64."""

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
    FORMS,
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
    write_forms,
)

__all__ = ["TILE", "prepare_faces", "raster_hits", "tile_bounds"]

TILE = 16
"""Side of the square tiles in rays."""

# What lies nearer to the plane of the eye than this share of its distance is taken to be anywhere in the image.
_GRAZING = 1e-6
# Tests that only skip work err by so much on the safe side, relative to the numbers' size; rounding is below 1e-9 even
# at `_GRAZING`, and below 1e-14 elsewhere.
_BOX_MARGIN = 1e-8
_PLANE_MARGIN = 1e-12
# Directions must point this far (cosine) into the half space of the axis.
_LEAST_COSINE = 0.05
# Range of a tile or a face in the projection's coordinates u and v.
_LOW_U, _HIGH_U, _LOW_V, _HIGH_V = range(4)


@numba.njit(cache=True, nogil=True, parallel=True)
def tile_bounds(directions: NDArray[np.float64], width: int, frame: NDArray[np.float64]) -> Any:
    """Bound the directions of every tile in the central projection along an axis.

    ``frame`` has two directions across and the axis as its rows. Returns (lowest u, highest u, lowest v, highest v) of
    every tile, shape (tile rows, tile columns, 4), and whether all rays point along the axis. Directions that are NaN
    are passed over.
    """
    height = directions.shape[0] // width
    rows, columns = (height + TILE - 1) // TILE, (width + TILE - 1) // TILE
    bounds = np.empty((rows, columns, 4), dtype=np.float64)
    forward = np.ones(rows, dtype=np.bool_)
    for row in numba.prange(rows):
        for column in range(columns):
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
            for y in range(row * TILE, min((row + 1) * TILE, height)):
                for x in range(column * TILE, min((column + 1) * TILE, width)):
                    dx, dy, dz = directions[y * width + x]
                    along = dx * frame[2, 0] + dy * frame[2, 1] + dz * frame[2, 2]
                    if np.isnan(along):
                        continue
                    if along <= _LEAST_COSINE * np.sqrt(dx * dx + dy * dy + dz * dz):
                        forward[row] = False
                        continue
                    u = (dx * frame[0, 0] + dy * frame[0, 1] + dz * frame[0, 2]) / along
                    v = (dx * frame[1, 0] + dy * frame[1, 1] + dz * frame[1, 2]) / along
                    low_u, high_u = min(low_u, u), max(high_u, u)
                    low_v, high_v = min(low_v, v), max(high_v, v)
            bounds[row, column, _LOW_U], bounds[row, column, _HIGH_U] = low_u, high_u
            bounds[row, column, _LOW_V], bounds[row, column, _HIGH_V] = low_v, high_v
    return bounds, forward.all()


@numba.njit(cache=True, nogil=True, parallel=True)
def prepare_faces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    origin: NDArray[np.float64],
    frame: NDArray[np.float64],
) -> Any:
    """Compute what the rays from one point share: the linear forms of every face, and where it lies.

    Returns the forms, shape (m, 16), and (lowest u, highest u, lowest v, highest v) of every face in the projection of
    ``frame``, shape (m, 4), with margins for rounding; an empty range for what lies behind.
    """
    count = faces.shape[0]
    forms = np.empty((count, FORMS), dtype=np.float64)
    boxes = np.empty((count, 4), dtype=np.float64)
    for face in numba.prange(count):
        low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        behind, grazing = True, False
        for corner in range(3):
            vertex = faces[face, corner]
            x, y, z = vertices[vertex, 0] - origin[0], vertices[vertex, 1] - origin[1], vertices[vertex, 2] - origin[2]
            along = x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2]
            size = np.sqrt(x * x + y * y + z * z)
            if along > -_PLANE_MARGIN * size:
                behind = False
            if along <= _GRAZING * size:
                grazing = True
                continue
            u = (x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2]) / along
            v = (x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2]) / along
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
        boxes[face, _LOW_U], boxes[face, _HIGH_U] = low_u, high_u
        boxes[face, _LOW_V], boxes[face, _HIGH_V] = low_v, high_v
        write_forms(vertices, faces, face, origin, forms[face])
    return forms, boxes


@numba.njit(cache=True, nogil=True)
def _edges_of_tile(form: NDArray[np.float64], frame: NDArray[np.float64], bounds: NDArray[np.float64]) -> Any:
    """Tell whether a face may be met in a tile, and whether all rays of the tile are inside its three edges."""
    may_positive, may_negative, all_positive, all_negative = True, True, True, True
    largest_u = max(abs(bounds[_LOW_U]), abs(bounds[_HIGH_U]))
    largest_v = max(abs(bounds[_LOW_V]), abs(bounds[_HIGH_V]))
    for edge in range(3):
        nx, ny, nz = form[3 * edge], form[3 * edge + 1], form[3 * edge + 2]
        along_u = nx * frame[0, 0] + ny * frame[0, 1] + nz * frame[0, 2]
        along_v = nx * frame[1, 0] + ny * frame[1, 1] + nz * frame[1, 2]
        constant = nx * frame[2, 0] + ny * frame[2, 1] + nz * frame[2, 2]
        blur = form[BLUR_X] + form[BLUR_Y] + form[BLUR_Z]
        margin = (_PLANE_MARGIN * np.sqrt(nx * nx + ny * ny + nz * nz) + blur) * (1.0 + largest_u + largest_v)
        one_u, two_u = along_u * bounds[_LOW_U], along_u * bounds[_HIGH_U]
        one_v, two_v = along_v * bounds[_LOW_V], along_v * bounds[_HIGH_V]
        lowest = min(one_u, two_u) + min(one_v, two_v) + constant - margin
        highest = max(one_u, two_u) + max(one_v, two_v) + constant + margin
        may_positive, may_negative = may_positive and highest >= 0.0, may_negative and lowest <= 0.0
        all_positive, all_negative = all_positive and lowest > 0.0, all_negative and highest < 0.0
    return may_positive or may_negative, all_positive or all_negative


@numba.njit(cache=True, nogil=True, parallel=True)
def raster_hits(
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    frame: NDArray[np.float64],
    bounds: NDArray[np.float64],
    directions: NDArray[np.float64],
    width: int,
) -> Any:
    """Find the first face, depth and barycentric coordinates of every ray of a grid.

    Every face is held against every ray of the tiles that it may touch: inside by the signs of three volumes, depth
    from its plane, the nearest wins, of equal ones the lower index.
    """
    count = directions.shape[0]
    height = count // width
    rows, columns = bounds.shape[0], bounds.shape[1]
    face_out = np.empty(count, dtype=np.int32)
    depth_out = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    half = (rows + 1) // 2
    for turn in numba.prange(rows):
        # Every other row of tiles, then the rest: threads get shares that cost alike.
        row = 2 * turn if turn < half else 2 * (turn - half) + 1
        top, bottom = row * TILE, min((row + 1) * TILE, height)
        for n in range(top * width, bottom * width):
            face_out[n], depth_out[n] = -1, np.inf
        row_low, row_high = bounds[row, :, _LOW_V].min(), bounds[row, :, _HIGH_V].max()
        for face in range(forms.shape[0]):
            if boxes[face, _LOW_V] > row_high or boxes[face, _HIGH_V] < row_low:
                continue
            form = forms[face]
            for column in range(columns):
                tile = bounds[row, column]
                if boxes[face, _LOW_U] > tile[_HIGH_U] or boxes[face, _HIGH_U] < tile[_LOW_U]:
                    continue
                if boxes[face, _LOW_V] > tile[_HIGH_V] or boxes[face, _HIGH_V] < tile[_LOW_V]:
                    continue
                possible, certain = _edges_of_tile(form, frame, tile)
                if not possible:
                    continue
                left, right = column * TILE, min((column + 1) * TILE, width)
                for y in range(top, bottom):
                    for n in range(y * width + left, y * width + right):
                        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
                        if not certain:
                            w2 = dx * form[W2_X] + dy * form[W2_Y] + dz * form[W2_Z]
                            w0 = dx * form[W0_X] + dy * form[W0_Y] + dz * form[W0_Z]
                            w1 = dx * form[W1_X] + dy * form[W1_Y] + dz * form[W1_Z]
                            blur = abs(dx) * form[BLUR_X] + abs(dy) * form[BLUR_Y] + abs(dz) * form[BLUR_Z]
                            if not inside(w0, w1, w2, blur):
                                continue
                        slope = form[NORMAL_X] * dx + form[NORMAL_Y] * dy + form[NORMAL_Z] * dz
                        if slope == 0.0:
                            continue
                        depth = form[DISTANCE] / slope
                        if depth > 0.0 and depth < depth_out[n]:
                            face_out[n], depth_out[n] = face, depth
        for n in range(top * width, bottom * width):
            if face_out[n] < 0:
                depth_out[n], weights[n, 0], weights[n, 1] = np.nan, 0.0, 0.0
                continue
            dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
            weights[n, 0], weights[n, 1] = weigh(forms[face_out[n]], dx, dy, dz)
    return face_out, depth_out, weights

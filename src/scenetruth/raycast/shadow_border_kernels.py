"""Kernels that find the borders of shadows on faces: shadows of contour edges, and lines where faces intersect."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.raycast.shadow_kernels import EDGES, LOWEST, PLANE, STEEP, FacesInLight, cell_of
from scenetruth.threads import in_bands

__all__ = ["cast_edges", "cross_faces", "measure_faces"]

_LEAST = 4096  # minimum number of faces per thread
_ROW_MARGIN = 1e-6  # relative margin of the cells for rounding


def measure_faces(
    vertices: NDArray[np.float64], places: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return centres of faces in mm, shape (m, 3), lowest and highest u, v and h, (m, 6), and their sides, (m,).

    ``vertices``: World positions in mm, shape (n, 3). ``places``: The same in light coordinates.
    Sides are whether the corners run counter-clockwise, seen along the light.
    """
    count = faces.shape[0]
    centres, boxes, front = np.empty((count, 3)), np.empty((count, 6)), np.empty(count, dtype=np.bool_)
    in_bands(_measure_faces, count, vertices, places, faces, centres, boxes, front, least=_LEAST)
    return centres, boxes, front


@kernel()
def _measure_faces(
    low: int, high: int, vertices: NDArray[np.float64], places: NDArray[np.float64], faces: NDArray[np.int32],
    centres: NDArray[np.float64], boxes: NDArray[np.float64], front: NDArray[np.bool_],
) -> None:  # fmt: skip
    for face in range(low, high):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        for axis in range(3):
            centres[face, axis] = (vertices[i, axis] + vertices[j, axis] + vertices[k, axis]) / 3.0
            one, two, three = places[i, axis], places[j, axis], places[k, axis]
            boxes[face, 2 * axis] = min(min(one, two), three)
            boxes[face, 2 * axis + 1] = max(max(one, two), three)
        ux, uy = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1]
        vx, vy = places[k, 0] - places[i, 0], places[k, 1] - places[i, 1]
        front[face] = ux * vy > uy * vx


@inlined
def _clip(at_start: float, at_end: float, enter: float, leave: float) -> Any:
    """Narrow a range of fractions of a segment to where a function with values at its ends is at least 0."""
    if at_start < 0.0 and at_end < 0.0:
        return 1.0, 0.0
    if at_start < 0.0:
        enter = max(enter, at_start / (at_start - at_end))
    elif at_end < 0.0:
        leave = min(leave, at_start / (at_start - at_end))
    return enter, leave


@subkernel()
def _shadow_on(
    ends: NDArray[np.float64], edge: int, numbers: NDArray[np.float64], face: int, apart: float
) -> Any:  # fmt: skip
    """Return the range of an edge, as fractions, whose shadow falls on a face."""
    u0, v0, h0, u1, v1, h1 = (
        ends[edge, 0, 0], ends[edge, 0, 1], ends[edge, 0, 2], ends[edge, 1, 0], ends[edge, 1, 1], ends[edge, 1, 2],
    )  # fmt: skip
    enter, leave = 0.0, 1.0
    for k in range(EDGES, PLANE, 3):
        across, down, constant = numbers[face, k], numbers[face, k + 1], numbers[face, k + 2]
        enter, leave = _clip(
            across * u0 + down * v0 + constant, across * u1 + down * v1 + constant, enter, leave
        )  # fmt: skip
        if not enter < leave:
            return 1.0, 0.0
    right, below, height = numbers[face, PLANE], numbers[face, PLANE + 1], numbers[face, PLANE + 2]
    # The edge must be nearer to the lamp than the face.
    first, last = right * u0 + below * v0 + height - h0 - apart, right * u1 + below * v1 + height - h1 - apart
    enter, leave = _clip(first, last, enter, leave)
    if not (leave - enter) * (abs(u1 - u0) + abs(v1 - v0)) > apart:
        return 1.0, 0.0
    return enter, leave


@kernel()
def cast_edges(
    ends: NDArray[np.float64],
    edge_faces: NDArray[np.int32],
    light: FacesInLight,
    apart: float,
    pairs: NDArray[np.int64],
    spans: NDArray[np.float64],
) -> int:
    """Find the faces on which the shadows of edges fall; return their number, which may exceed the space.

    ``ends``: Ends of the edges in light coordinates, shape (k, 2, 3).
    ``edge_faces``: Their faces, on which they cast no shadow, -1 for none, shape (k, 2).
    ``apart``: Distance in mm below which faces touch, and shadows are ignored.
    ``pairs``: Output: edge and face, shape (space, 2). A pair may occur several times.
    ``spans``: Output: range of the edge as fractions, shape (space, 2).
    """
    numbers, low, per_cell = light.numbers, light.low, light.per_cell
    used, space = 0, pairs.shape[0]
    for edge in range(ends.shape[0]):
        u0, v0, u1, v1 = ends[edge, 0, 0], ends[edge, 0, 1], ends[edge, 1, 0], ends[edge, 1, 1]
        one, two = edge_faces[edge, 0], edge_faces[edge, 1]
        margin = _ROW_MARGIN / per_cell
        top = cell_of(min(v0, v1) - margin, low[1], per_cell, light.rows - 1)
        bottom = cell_of(max(v0, v1) + margin, low[1], per_cell, light.rows - 1)
        for row in range(top, bottom + 2):
            left, right = 0, -1
            if row <= bottom:
                # The part of the edge in this row.
                enter, leave = 0.0, 1.0
                above, below = low[1] + row / per_cell - margin, low[1] + (row + 1) / per_cell + margin
                if row > 0:
                    enter, leave = _clip(v0 - above, v1 - above, enter, leave)
                if row < light.rows - 1:
                    enter, leave = _clip(below - v0, below - v1, enter, leave)
                if not enter <= leave:
                    continue
                ua, ub = u0 + enter * (u1 - u0), u0 + leave * (u1 - u0)
                left = cell_of(min(ua, ub) - margin, low[0], per_cell, light.columns - 1)
                right = cell_of(max(ua, ub) + margin, low[0], per_cell, light.columns - 1)
            # After the last row come the faces that are not listed in cells.
            for column in range(left, right + 1 if row <= bottom else 1):
                cell = row * light.columns + column
                first = light.starts[cell] if row <= bottom else 0
                last = light.starts[cell + 1] if row <= bottom else light.large.shape[0]
                for entry in range(first, last):
                    face = light.listed[entry] if row <= bottom else light.large[entry]
                    if face in (one, two) or not numbers[face, STEEP] < np.inf:
                        continue
                    enter, leave = _shadow_on(ends, edge, numbers, face, apart)
                    if enter < leave:
                        if used < space:
                            pairs[used, 0], pairs[used, 1] = edge, face
                            spans[used, 0], spans[used, 1] = enter, leave
                        used += 1
    return used


@subkernel()
def _height_over(plane: NDArray[np.float64], point: NDArray[np.float64]) -> Any:
    """Return the distance of a point from a plane, given by a point and the unit normal."""
    return (
        plane[3] * (point[0] - plane[0]) + plane[4] * (point[1] - plane[1]) + plane[5] * (point[2] - plane[2])
    )  # fmt: skip


@subkernel()
def _plane_of(
    places: NDArray[np.float64], corners: NDArray[np.int32], plane: NDArray[np.float64]
) -> None:  # fmt: skip
    """Write a corner and the unit normal of a face, zero for faces without area."""
    a, b, c = places[corners[0]], places[corners[1]], places[corners[2]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
    plane[0], plane[1], plane[2], plane[3], plane[4], plane[5] = a[0], a[1], a[2], nx / length, ny / length, nz / length


@subkernel()
def _crossing(
    places: NDArray[np.float64], one: NDArray[np.int32], other: NDArray[np.int32], planes: NDArray[np.float64],
    line: NDArray[np.float64], apart: float,
) -> Any:  # fmt: skip
    """Write the ends of the line in which two faces intersect; return whether there is one."""
    _plane_of(places, one, planes[0])
    _plane_of(places, other, planes[1])
    for k in range(2):
        # Faces that only touch do not intersect.
        corners, plane = (one, planes[1]) if k == 0 else (other, planes[0])
        heights = (
            _height_over(plane, places[corners[0]]),
            _height_over(plane, places[corners[1]]),
            _height_over(plane, places[corners[2]]),
        )
        if not (min(heights) < -apart and max(heights) > apart):
            return False
    found = 0
    for k in range(3):
        start, end = places[one[k]], places[one[(k + 1) % 3]]
        before, after = _height_over(planes[1], start), _height_over(planes[1], end)
        if (before > 0.0) != (after > 0.0) and found < 2:
            share = before / (before - after)
            for m in range(3):
                line[found, m] = start[m] + share * (end[m] - start[m])
            found += 1
    if found < 2:
        return False
    # The part of this line inside the other face.
    enter, leave = 0.0, 1.0
    for k in range(3):
        start, end = places[other[k]], places[other[(k + 1) % 3]]
        ex, ey, ez = end[0] - start[0], end[1] - start[1], end[2] - start[2]
        nx, ny, nz = planes[1, 3], planes[1, 4], planes[1, 5]
        sx, sy, sz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        at_start = sx * (line[0, 0] - start[0]) + sy * (line[0, 1] - start[1]) + sz * (line[0, 2] - start[2])
        at_end = sx * (line[1, 0] - start[0]) + sy * (line[1, 1] - start[1]) + sz * (line[1, 2] - start[2])
        enter, leave = _clip(at_start, at_end, enter, leave)
    length = 0.0
    for m in range(3):
        start_m, step = line[0, m], line[1, m] - line[0, m]
        line[0, m], line[1, m] = start_m + enter * step, start_m + leave * step
        length += abs(step)
    return (leave - enter) * length > apart


@kernel()
def cross_faces(
    places: NDArray[np.float64],
    faces: NDArray[np.int32],
    boxes: NDArray[np.float64],
    light: FacesInLight,
    apart: float,
    pairs: NDArray[np.int64],
    lines: NDArray[np.float64],
) -> int:
    """Find the faces without a common corner that intersect; return their number, which may exceed the space.

    ``places``: Vertices in light coordinates, shape (n, 3).
    ``boxes``: Lowest and highest u, v and h of the faces, shape (m, 6).
    ``apart``: As in `cast_edges`.
    ``pairs``: Output: the two faces, shape (space, 2). A pair may occur several times.
    ``lines``: Output: ends of the line in which they intersect, shape (space, 2, 3).
    """
    planes, line = np.empty((2, 6)), np.empty((2, 3))
    used, space, cells = 0, pairs.shape[0], light.starts.shape[0] - 1
    # After the cells, the faces that are not listed in them are compared with all faces.
    for cell in range(cells + light.large.shape[0]):
        first = light.starts[cell] if cell < cells else 0
        last = light.starts[cell + 1] if cell < cells else 1
        for entry in range(first, last):
            one = light.listed[entry] if cell < cells else light.large[cell - cells]
            low_u, high_u, low_v, high_v = boxes[one, 0], boxes[one, 1], boxes[one, 2], boxes[one, 3]
            lowest, highest = boxes[one, 4], boxes[one, 5]
            for second in range(entry + 1 if cell < cells else 0, last if cell < cells else faces.shape[0]):
                other = light.listed[second] if cell < cells else second
                if cell < cells and light.numbers[other, LOWEST] > highest:
                    # All following faces of the cell are behind this face, too.
                    break
                if boxes[other, 0] > high_u or boxes[other, 1] < low_u or boxes[other, 2] > high_v:
                    continue
                if boxes[other, 3] < low_v or boxes[other, 4] > highest or boxes[other, 5] < lowest:
                    continue
                common = False
                for k in range(3):
                    for m in range(3):
                        common = common or faces[one, k] == faces[other, m]
                if common or not _crossing(places, faces[one], faces[other], planes, line, apart):
                    continue
                if used < space:
                    pairs[used, 0], pairs[used, 1] = one, other
                    for k in range(2):
                        for m in range(3):
                            lines[used, k, m] = line[k, m]
                used += 1
    return used

"""Kernels that decide in float64 whether a face lies between a light and a point."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.threads import in_bands

__all__ = [
    "BLOCKED",
    "EDGES",
    "LIT",
    "LOWEST",
    "PLANE",
    "STEEP",
    "UNSURE",
    "FacesInLight",
    "cell_of",
    "confirm_blocked",
    "flatten_faces",
    "groups_above",
    "parallel_shadows",
    "sort_faces",
]


@subkernel()
def meets(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, start: NDArray[np.float64],
    way: NDArray[np.float64], farthest: float,
) -> Any:  # fmt: skip
    """Return whether a ray hits a face within a fraction of its length.

    Test of Möller and Trumbore (J. Graphics Tools 2, 1997).
    """
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ux, uy, uz = (vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2])
    vx, vy, vz = (vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2])
    px, py, pz = way[1] * vz - way[2] * vy, way[2] * vx - way[0] * vz, way[0] * vy - way[1] * vx
    volume = ux * px + uy * py + uz * pz
    if volume == 0.0:
        return False
    sx, sy, sz = start[0] - vertices[i, 0], start[1] - vertices[i, 1], start[2] - vertices[i, 2]
    b1 = (sx * px + sy * py + sz * pz) / volume
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    b2 = (way[0] * qx + way[1] * qy + way[2] * qz) / volume
    if b1 < 0.0 or b2 < 0.0 or b1 + b2 > 1.0:
        return False
    along = (vx * qx + vy * qy + vz * qz) / volume
    return along >= 0.0 and along < farthest


def confirm_blocked(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    starts: NDArray[np.float64],
    ways: NDArray[np.float64],
    guesses: NDArray[np.int32],
    own: NDArray[np.int32],
    farthest: float,
) -> NDArray[np.bool_]:
    """Return which rays from a light are blocked before they reach their point.

    The candidate face from Embree and its three neighbours are tested in float64, except the face of the point.

    ``vertices``: World positions in mm, shape (n, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``neighbours``: Face across each edge, shape (m, 3), -1 for none (`Topology.face_neighbours`).
    ``starts``: Ray origins in mm, shape (k, 3).
    ``ways``: Vectors from there to the points, in mm, shape (k, 3).
    ``guesses``: Candidate face of each ray from Embree, -1 for none, shape (k,).
    ``own``: Face of each point, shape (k,).
    Returns: bool, shape (k,).
    """
    count = starts.shape[0]
    out = np.empty(count, dtype=np.bool_)
    in_bands(_confirm_blocked, count, vertices, faces, neighbours, starts, ways, guesses, own, farthest, out)
    return out


@kernel()
def _confirm_blocked(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], neighbours: NDArray[np.int32],
    starts: NDArray[np.float64], ways: NDArray[np.float64], guesses: NDArray[np.int32], own: NDArray[np.int32],
    farthest: float, out: NDArray[np.bool_],
) -> None:  # fmt: skip
    for n in range(low, high):
        guess = guesses[n]
        blocked = False
        if guess >= 0 and guess != own[n]:
            blocked = meets(vertices, faces, guess, starts[n], ways[n], farthest)
            for k in range(3):
                beside = neighbours[guess, k]
                if not blocked and beside >= 0 and beside != own[n]:
                    blocked = meets(vertices, faces, beside, starts[n], ways[n], farthest)
        out[n] = blocked


LIT, BLOCKED, UNSURE = range(3)
"""Shadow state of a point."""

# Indices into the numbers of a face in light coordinates: lowest corner; coefficients of u, v and 1 for the distance
# inside each of three edges and for the plane height h; and the gradient of h.
LOWEST, EDGES, PLANE, STEEP = 0, 1, 10, 13
NUMBERS = 16
_STEEPEST = 1e3  # for faces steeper than this, only the heights of their corners are used
_MOST = 24  # maximum number of faces distinguished on one ray
_LEAST = 256  # minimum number of points per thread
LARGE = 1 << 14  # faces that touch more cells than this are tested for every point
_FEW = 4  # for faces that touch more cells than this, every cell of the bounding box is tested
_CELL_MARGIN = 1e-6  # relative margin of the cells for rounding


class FacesInLight(NamedTuple):
    """Faces of a mesh in cells across a parallel light; heights are along the light, lower is nearer to the lamp."""

    frame: NDArray[np.float64]
    """Two unit vectors across the light and its direction, as rows of a rotation."""
    numbers: NDArray[np.float64]
    """Numbers of all faces, see `flatten_faces`."""
    low: NDArray[np.float64]
    """Lowest u and v of the cells, shape (2,)."""
    per_cell: float
    """Cells per mm."""
    columns: int
    """Cells along u."""
    rows: int
    """Cells along v."""
    starts: NDArray[np.int64]
    """Start index of the list of each cell, and the total."""
    listed: NDArray[np.int32]
    """Faces that may touch each cell, cell by cell, in ascending order of their lowest corners."""
    large: NDArray[np.int32]
    """Faces that touch too many cells to be listed."""
    tolerance: float
    """Tolerance in mm for the float32 errors of Embree."""


def flatten_faces(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], frame: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the numbers of every face, shape (m, `NUMBERS`), and its lowest and highest u and v, shape (m, 4).

    The ranges include all rays that pass the edges within the tolerance; those of edge-on faces are infinite. Other
    arguments are as in `FacesInLight`.
    """
    count = faces.shape[0]
    numbers = np.empty((count, NUMBERS), dtype=np.float64)
    boxes = np.empty((count, 4), dtype=np.float64)
    in_bands(_flatten_faces, count, vertices, faces, frame, tolerance, numbers, boxes)
    return numbers, boxes


@kernel()
def _flatten_faces(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], frame: NDArray[np.float64],
    tolerance: float, numbers: NDArray[np.float64], boxes: NDArray[np.float64],
) -> None:  # fmt: skip
    place = np.empty((3, 3), dtype=np.float64)
    for face in range(low, high):
        for corner in range(3):
            vertex = faces[face, corner]
            for k in range(3):
                place[corner, k] = (
                    vertices[vertex, 0] * frame[k, 0]
                    + vertices[vertex, 1] * frame[k, 1]
                    + vertices[vertex, 2] * frame[k, 2]
                )
        a, b, c = place[0], place[1], place[2]
        around, longest, from_corner = 0.0, 0.0, 0
        for k in range(3):
            p, q = place[k], place[(k + 1) % 3]
            length = np.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2)
            around += length
            if length > longest:
                longest, from_corner = length, k
        out = numbers[face]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[LOWEST] = min(a[2], b[2], c[2])
        steep = np.sqrt(nx * nx + ny * ny)
        if abs(nz) * _STEEPEST <= steep or nz == 0.0:
            # Edge-on faces never block with certainty, and float32 may place them in front of all other faces.
            out[LOWEST] = -np.inf
            out[EDGES:PLANE] = 0.0
            out[PLANE : PLANE + 3] = 0.0
            out[STEEP] = np.inf
            boxes[face, ::2], boxes[face, 1::2] = -np.inf, np.inf
            if longest > 0.0:
                # Any ray through the strip along the longest edge may count as a hit due to rounding.
                p, q, r = place[from_corner], place[(from_corner + 1) % 3], place[(from_corner + 2) % 3]
                across, down = (p[1] - q[1]) / longest, (q[0] - p[0]) / longest
                width = across * (r[0] - p[0]) + down * (r[1] - p[1])
                there = across * p[0] + down * p[1]
                out[EDGES], out[EDGES + 1], out[EDGES + 2] = across, down, -there - min(width, 0.0)
                for at in (EDGES + 3, EDGES + 6):
                    out[at], out[at + 1], out[at + 2] = -across, -down, there + max(width, 0.0)
            continue
        # All edges moved outwards by the tolerance give a triangle that is larger, as seen from the incentre, by that
        # over the inradius |nz| / around: at sharp corners much more than the tolerance.
        margin = tolerance * (1.0 + longest * around / abs(nz))
        boxes[face, 0], boxes[face, 1] = min(a[0], b[0], c[0]) - margin, max(a[0], b[0], c[0]) + margin
        boxes[face, 2], boxes[face, 3] = min(a[1], b[1], c[1]) - margin, max(a[1], b[1], c[1]) + margin
        side = 1.0 if nz > 0.0 else -1.0
        for k in range(3):
            p, q = place[k], place[(k + 1) % 3]
            ex, ey = q[0] - p[0], q[1] - p[1]
            length = side * np.sqrt(ex * ex + ey * ey)
            at = EDGES + 3 * k
            out[at], out[at + 1] = -ey / length, ex / length
            out[at + 2] = -(out[at] * p[0] + out[at + 1] * p[1])
        out[PLANE], out[PLANE + 1] = -nx / nz, -ny / nz
        out[PLANE + 2] = a[2] - out[PLANE] * a[0] - out[PLANE + 1] * a[1]
        out[STEEP] = steep / abs(nz)


@inlined
def cell_of(value: float, low: float, per_cell: float, last: int) -> Any:
    """Return the cell of a coordinate, from 0 to ``last``, monotonic in the coordinate."""
    return int(min(max((value - low) * per_cell, 0.0), last + 0.0))


@subkernel()
def _touches(numbers: NDArray[np.float64], face: int, u: float, v: float, edge: float, tolerance: float) -> Any:
    """Return whether a face may touch the cell with lowest corner (u, v)."""
    for first in range(EDGES, PLANE, 3):
        across, down = numbers[face, first], numbers[face, first + 1]
        highest = across * u + down * v + numbers[face, first + 2] + edge * (max(across, 0.0) + max(down, 0.0))
        if highest < -tolerance:
            return False
    return True


def sort_faces(
    numbers: NDArray[np.float64],
    boxes: NDArray[np.float64],
    low: NDArray[np.float64],
    per_cell: float,
    columns: int,
    rows: int,
    tolerance: float,
) -> Any:
    """Sort faces into cells, each beginning with the face nearest to the lamp."""
    order = np.argsort(numbers[:, LOWEST], kind="stable")
    return _sort_into_cells(order, numbers, boxes, low, per_cell, columns, rows, tolerance)


@kernel()
def _sort_into_cells(
    order: NDArray[np.int64],
    numbers: NDArray[np.float64],
    boxes: NDArray[np.float64],
    low: NDArray[np.float64],
    per_cell: float,
    columns: int,
    rows: int,
    tolerance: float,
) -> Any:
    starts = np.zeros(rows * columns + 1, dtype=np.int64)
    large = np.empty(boxes.shape[0], dtype=np.int32)
    listed, place = np.empty(0, dtype=np.int32), starts
    used, edge = 0, (1.0 + _CELL_MARGIN) / per_cell
    # The first pass counts, the second fills.
    for fill in (False, True):
        for face in order:
            left = cell_of(boxes[face, 0], low[0], per_cell, columns - 1)
            right = cell_of(boxes[face, 1], low[0], per_cell, columns - 1)
            top = cell_of(boxes[face, 2], low[1], per_cell, rows - 1)
            bottom = cell_of(boxes[face, 3], low[1], per_cell, rows - 1)
            number = (right - left + 1) * (bottom - top + 1)
            if number > LARGE:
                if not fill:
                    large[used] = face
                    used += 1
                continue
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    if number > _FEW:
                        u = low[0] + (column - 0.5 * _CELL_MARGIN) / per_cell
                        v = low[1] + (row - 0.5 * _CELL_MARGIN) / per_cell
                        if not _touches(numbers, face, u, v, edge, tolerance):
                            continue
                    cell = row * columns + column
                    if fill:
                        listed[place[cell]] = face
                        place[cell] += 1
                    else:
                        starts[cell + 1] += 1
        if not fill:
            for cell in range(rows * columns):
                starts[cell + 1] += starts[cell]
            listed, place = np.empty(starts[-1], dtype=np.int32), starts[:-1].copy()
    return starts, listed, large[:used].copy()


@inlined
def _inside(numbers: NDArray[np.float64], face: int, u: float, v: float) -> Any:
    """Return the distance of a ray inside the edges of a face, negative outside; for edge-on faces, in their strip."""
    return min(
        numbers[face, EDGES] * u + numbers[face, EDGES + 1] * v + numbers[face, EDGES + 2],
        numbers[face, EDGES + 3] * u + numbers[face, EDGES + 4] * v + numbers[face, EDGES + 5],
        numbers[face, EDGES + 6] * u + numbers[face, EDGES + 7] * v + numbers[face, EDGES + 8],
    )


@inlined
def _lowest(numbers: NDArray[np.float64], face: int, u: float, v: float, tolerance: float) -> Any:
    """Return the lowest possible height of a face at a ray within the tolerances of both."""
    lowest = numbers[face, LOWEST] - tolerance
    if numbers[face, STEEP] < np.inf:
        height = numbers[face, PLANE] * u + numbers[face, PLANE + 1] * v + numbers[face, PLANE + 2]
        lowest = max(lowest, height - tolerance * (1.0 + numbers[face, STEEP]))
    return lowest


@subkernel()
def _decide(
    numbers: NDArray[np.float64], tolerance: float, u: float, v: float, height_of_point: float, own: int,
    touched: NDArray[np.int32], met: NDArray[np.bool_], used: int, neighbours: NDArray[np.int32],
) -> Any:  # fmt: skip
    """Return whether every possible candidate of Embree, within rounding, is a hit face or adjacent to one."""
    certain = np.inf
    for k in range(used):
        face = touched[k]
        if met[k] and _inside(numbers, face, u, v) >= tolerance:
            height = numbers[face, PLANE] * u + numbers[face, PLANE + 1] * v + numbers[face, PLANE + 2]
            certain = min(certain, height + tolerance * (1.0 + numbers[face, STEEP]))
    # Faces behind the point were not evaluated.
    if not certain < height_of_point:
        return UNSURE
    # Embree certainly has a hit up to this height; all possible first hits must be confirmed.
    for k in range(used):
        face = touched[k]
        if met[k] or _lowest(numbers, face, u, v, tolerance) > certain:
            continue
        beside = False
        for side in range(3):
            for other in range(used):
                beside = beside or (met[other] and touched[other] == neighbours[face, side])
        if face == own or not beside:
            return UNSURE
    return BLOCKED


def parallel_shadows(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    light: FacesInLight,
    points: NDArray[np.float64],
    own: NDArray[np.int32],
    wanted: NDArray[np.bool_],
    to_light: NDArray[np.float64],
    reach: float,
    farthest: float,
) -> NDArray[np.uint8]:
    """Return the shadow state of points under parallel light.

    The result equals that of `confirm_blocked` for any candidate of Embree. A point is lit if no face except its own is
    hit in float64. It is blocked if a face is hit well inside its edges, and if every possible first face of Embree,
    within rounding, is a hit face or adjacent to one.

    ``points``: The points in mm, shape (n, 3).
    ``own``: Face of each point, shape (n,).
    ``neighbours``: As in `confirm_blocked`; empty if hits need no confirmation: then no point is `UNSURE`.
    ``wanted``: Points to evaluate, shape (n,).
    ``to_light``: Unit vector towards the light, shape (3,).
    ``reach``: Length of the rays in mm.
    Returns: `LIT`, `BLOCKED` or `UNSURE`, shape (n,), uint8.
    """
    count = points.shape[0]
    out = np.zeros(count, dtype=np.uint8)
    mesh, asked = (vertices, faces, neighbours), (points, own, wanted)
    in_bands(_parallel_shadows, count, *mesh, light, *asked, to_light * -reach, farthest, out, least=_LEAST)
    return out


@kernel()
def _parallel_shadows(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], neighbours: NDArray[np.int32],
    light: FacesInLight, points: NDArray[np.float64], own: NDArray[np.int32], wanted: NDArray[np.bool_],
    way: NDArray[np.float64], farthest: float, out: NDArray[np.uint8],
) -> None:  # fmt: skip
    frame, tolerance, numbers = light.frame, light.tolerance, light.numbers
    low_u, low_v, per_cell = light.low[0], light.low[1], light.per_cell
    columns, rows, starts, listed, large = light.columns, light.rows, light.starts, light.listed, light.large
    start = np.empty(3)
    touched, met = np.empty(_MOST, dtype=np.int32), np.empty(_MOST, dtype=np.bool_)
    confirmed, apart = neighbours.shape[0] > 0, np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2) * (1.0 - farthest)
    for n in range(low, high):
        if not wanted[n]:
            continue
        u = points[n, 0] * frame[0, 0] + points[n, 1] * frame[0, 1] + points[n, 2] * frame[0, 2]
        v = points[n, 0] * frame[1, 0] + points[n, 1] * frame[1, 1] + points[n, 2] * frame[1, 2]
        h = points[n, 0] * frame[2, 0] + points[n, 1] * frame[2, 1] + points[n, 2] * frame[2, 2]
        cell = cell_of(v, low_v, per_cell, rows - 1) * columns + cell_of(u, low_u, per_cell, columns - 1)
        first = starts[cell]
        entries = starts[cell + 1] - first
        # Same operations as for the rays passed to Embree.
        for k in range(3):
            start[k] = points[n, k] - way[k]
        found, used = 0, 0
        entry = -1
        while entry + 1 < entries + large.shape[0]:
            entry += 1
            face = listed[first + entry] if entry < entries else large[entry - entries]
            if numbers[face, LOWEST] - tolerance > h:
                # All following faces are behind the point too.
                entry = max(entry, entries - 1)
                continue
            if not confirmed:
                height = numbers[face, PLANE] * u + numbers[face, PLANE + 1] * v + numbers[face, PLANE + 2]
                nearer = height < h - apart and numbers[face, STEEP] < np.inf and face != own[n]
                if nearer and _inside(numbers, face, u, v) >= 0.0:
                    out[n] = BLOCKED
                    break
                continue
            if not _inside(numbers, face, u, v) >= -tolerance or _lowest(numbers, face, u, v, tolerance) > h:
                continue
            hit = face != own[n] and meets(vertices, faces, face, start, way, farthest)
            found += hit
            if used < _MOST:
                touched[used], met[used] = face, hit
            used += 1
        if found > 0:
            out[n] = (
                UNSURE if used > _MOST else _decide(numbers, tolerance, u, v, h, own[n], touched, met, used, neighbours)
            )


def groups_above(
    light: FacesInLight,
    points: NDArray[np.float64],
    own: NDArray[np.int32],
    wanted: NDArray[np.bool_],
    groups: NDArray[np.uint8],
    apart: float,
) -> NDArray[np.uint64]:
    """Return the groups of the faces between points and parallel light, one bit each from the lowest, shape (n,).

    Faces are hit as in `parallel_shadows` without confirmation.

    ``groups``: Group of each face, below 64, shape (m,).
    ``apart``: Distance in mm up to which faces do not count.
    """
    out = np.zeros(points.shape[0], dtype=np.uint64)
    in_bands(_groups_above, points.shape[0], light, points, own, wanted, groups, apart, out, least=_LEAST)
    return out


@kernel()
def _groups_above(
    low: int, high: int, light: FacesInLight, points: NDArray[np.float64], own: NDArray[np.int32],
    wanted: NDArray[np.bool_], groups: NDArray[np.uint8], apart: float, out: NDArray[np.uint64],
) -> None:  # fmt: skip
    frame, tolerance, numbers = light.frame, light.tolerance, light.numbers
    listed, large = light.listed, light.large
    for n in range(low, high):
        if not wanted[n]:
            continue
        u = points[n, 0] * frame[0, 0] + points[n, 1] * frame[0, 1] + points[n, 2] * frame[0, 2]
        v = points[n, 0] * frame[1, 0] + points[n, 1] * frame[1, 1] + points[n, 2] * frame[1, 2]
        h = points[n, 0] * frame[2, 0] + points[n, 1] * frame[2, 1] + points[n, 2] * frame[2, 2]
        cell = cell_of(v, light.low[1], light.per_cell, light.rows - 1) * light.columns
        cell += cell_of(u, light.low[0], light.per_cell, light.columns - 1)
        first = light.starts[cell]
        entries = light.starts[cell + 1] - first
        found, entry = np.uint64(0), -1
        while entry + 1 < entries + large.shape[0]:
            entry += 1
            face = listed[first + entry] if entry < entries else large[entry - entries]
            if numbers[face, LOWEST] - tolerance > h:
                # All following faces are behind the point too.
                entry = max(entry, entries - 1)
                continue
            bit = np.uint64(1) << np.uint64(groups[face])
            if found & bit or face == own[n]:
                continue
            height = numbers[face, PLANE] * u + numbers[face, PLANE + 1] * v + numbers[face, PLANE + 2]
            nearer = height < h - apart and numbers[face, STEEP] < np.inf
            if nearer and _inside(numbers, face, u, v) >= 0.0:
                found |= bit
        out[n] = found

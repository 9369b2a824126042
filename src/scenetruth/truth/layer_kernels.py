"""Kernels that find where a camera sees a single layer of surface, whose points nothing occludes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.threads import in_bands

__all__ = ["FRONT", "IGNORED", "Layers", "are_clear", "find_convex_faces", "find_layers"]

_CELL_PX = 4.0  # side length of the cells of the image
# Samples at the middle of cells would meet vertices in scenes with symmetries.
_SAMPLE = 0.5 + 0.0123456789  # position of the sampled line in a row of cells
_MARGIN = 1e-6  # margin of lines, as a fraction of a cell
_ROUNDING = 1e-12  # relative margin of image coordinates for rounding
_GRAZING = 1e-6  # faces with a corner depth below this fraction of their size may cover the whole image
_LEAST_COSINE = 1e-9  # cosine of the angle between a face and the view below which it counts as edge-on
_SAFE = 1e-6  # relative margin of depths in cells for rounding and for the margins of cells
_BLUR = 1e-14  # relative rounding error of the scalar product of a normal and a corner
_FLAT = 1e-9  # relative distance in front of a face at which the vertices of a convex body may lie due to rounding
_MOST_TESTED = 1_000_000  # number of pairs of vertices and faces of a body up to which it is tested for convexity
_MOST_SEARCHED = 256  # number of cells up to which rectangles are searched
_LEAST_FACES = 4096  # minimum number of faces per thread

FRONT, IGNORED, EDGE_ON = 1, 2, 4
"""Bits of the side of a face: its normal (p1 - p0) x (p2 - p0) is towards the camera; it is not a layer of surface, as
faces behind the camera and back faces of convex bodies; it is not, but may occlude points, because it is edge-on."""


class Layers(NamedTuple):
    """Sides of the faces towards a camera, and cells of its image where bodies are a single layer of surface."""

    sides: NDArray[np.uint8]
    """Bits of the sides of the faces, shape (m,)."""
    boxes: NDArray[np.int32]
    """First row, first column, number of rows and of columns of the cells of each body, shape (bodies, 4)."""
    starts: NDArray[np.int64]
    """Index of the first cell of each body, shape (bodies,)."""
    single: NDArray[np.bool_]
    """Whether exactly one face of the body is over each point of a cell of its box, by rows, for all bodies."""
    nearest: NDArray[np.float64]
    """Least depth of a body over each cell and of all others, in mm, shape (rows, columns, 2)."""
    nearest_body: NDArray[np.int32]
    """The first of these bodies, shape (rows, columns)."""
    inverse: float
    """Number of cells per px; the first cell begins at (-0.5, -0.5)."""
    size: tuple[float, float]
    """Width and height of the image in cells."""


def find_convex_faces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    sides_across: NDArray[np.int32],
    face_offsets: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Mark the faces of closed convex bodies with normals outwards, shape (m,); bodies of many faces are not tested.

    ``vertices``: Positions in mm, shape (k, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``sides_across``: See `scenetruth.raycast.Topology`.
    ``face_offsets``: Index of the first face of each body, followed by m.
    """
    found = np.zeros(len(faces), dtype=np.bool_)
    for begin, end in pairwise(face_offsets.tolist()):
        across = sides_across[begin:end]
        if end - begin < 4 or 3 * (end - begin) ** 2 > _MOST_TESTED:
            continue
        # Every side belongs to two faces of this body.
        if (across >= 3 * begin).all() and (across < 3 * end).all():
            found[begin:end] = _is_convex(vertices[faces[begin:end]])
    return found


def _is_convex(corners: NDArray[np.float64]) -> bool:
    """Return whether no corner of faces, shape (m, 3, 3), is in front of the plane of a face, and some are behind."""
    first = corners[:, 0]
    normals = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    steps = corners.reshape(-1, 3) - corners[0, 0]
    distances = normals @ steps.T - np.einsum("ij,ij->i", normals, first - corners[0, 0])[:, None]
    limit = _FLAT * np.linalg.norm(normals, axis=1) * np.abs(steps).max()
    return bool((distances.max(axis=1) <= limit).all() and (distances.min(axis=1) < -limit).all())


def find_layers(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    sides_across: NDArray[np.int32],
    convex: NDArray[np.bool_],
    face_offsets: NDArray[np.int64],
    pinhole: tuple[float, float, float],
    width: int,
    height: int,
) -> Layers:
    """Find the cells of an image over which a body is a single layer of surface, and the depth of the nearest bodies.

    The number of layers of a body over a point changes only across lines: sides of faces without a neighbour, or whose
    neighbour lies on the same side in the image, as at silhouettes. In cells without lines it is the number of faces
    that begin minus those that end to the left of a point in them, at the lines across a row. The back faces of a
    convex body are behind its front faces, and do not count.

    ``vertices``: Positions in the camera frame in mm, shape (k, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``sides_across``: See `scenetruth.raycast.Topology`.
    ``convex``: Faces of closed convex bodies, shape (m,).
    ``face_offsets``: Index of the first face of each body, followed by m.
    ``pinhole``: Focal length and principal point in px.
    ``width``, ``height``: Size of the image in px.
    """
    count, bodies = faces.shape[0], len(face_offsets) - 1
    rows, columns = int(np.ceil(height / _CELL_PX)), int(np.ceil(width / _CELL_PX))
    sides, large = np.empty(count, dtype=np.uint8), np.zeros(1, dtype=np.bool_)
    in_bands(_face_sides, count, vertices, faces, sides, large, least=_LEAST_FACES)
    boxes, starts = np.zeros((bodies, 4), dtype=np.int32), np.zeros(bodies, dtype=np.int64)
    several = bodies > 1 and not large[0]
    nearest = np.full((rows, columns, 2) if several else (1, 1, 2), np.inf)
    nearest_body = np.full(nearest.shape[:2], -1, dtype=np.int32)
    single = np.zeros(0, dtype=np.bool_)
    if not large[0]:
        cells = _to_cells(vertices, pinhole)
        # Inside a convex body all its faces are back faces.
        for begin, end in pairwise(face_offsets.tolist()):
            if convex[begin] and (sides[begin:end] == FRONT).any():
                own = sides[begin:end]
                own[own == 0] = IGNORED
        _find_boxes(cells, faces, sides, face_offsets, rows, columns, boxes)
        sizes = boxes[:, 2].astype(np.int64) * boxes[:, 3]
        starts = np.cumsum(sizes) - sizes
        single = np.ones(sizes.sum(), dtype=np.bool_)
        steps = np.zeros((sizes + boxes[:, 2]).sum(), dtype=np.int32)
        _find_single(vertices, cells, faces, sides_across, sides, face_offsets, boxes, starts, steps, single)
        if several:
            _find_nearest(vertices, cells, faces, sides, face_offsets, pinhole, nearest, nearest_body)
    size = (width / _CELL_PX, height / _CELL_PX)
    return Layers(sides, boxes, starts, single, nearest, nearest_body, 1 / _CELL_PX, size)


@inlined
def are_clear(layers: Layers, body: int, low_x: float, high_x: float, low_y: float, high_y: float, depth: float) -> Any:
    """Return whether all points of a body in a rectangle, up to a depth, are in the image and not occluded.

    The rectangle is in cells from the corner of the image. Large rectangles are not searched.
    """
    low_x, high_x, low_y, high_y = low_x - _MARGIN, high_x + _MARGIN, low_y - _MARGIN, high_y + _MARGIN
    # Comparisons with NaN are false.
    if not ((low_x >= 0.0) & (high_x <= layers.size[0]) & (low_y >= 0.0) & (high_y <= layers.size[1])):
        return False
    left, right, top, bottom = int(low_x), int(high_x), int(low_y), int(high_y)
    if (right - left + 1) * (bottom - top + 1) > _MOST_SEARCHED:
        return False
    first_row, first_column = layers.boxes[body, 0], layers.boxes[body, 1]
    rows, columns = layers.boxes[body, 2], layers.boxes[body, 3]
    if top < first_row or left < first_column or bottom >= first_row + rows or right >= first_column + columns:
        return False
    start = layers.starts[body] - first_column
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if not layers.single[start + (row - first_row) * columns + column]:
                return False
    if layers.nearest_body.size > 1:
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                other = 1 if layers.nearest_body[row, column] == body else 0
                if not depth < layers.nearest[row, column, other]:
                    return False
    return True


@kernel()
def _face_sides(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], sides: NDArray[np.uint8],
    large: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Find the sides of faces towards the origin; ``large`` if a face may cover the whole image."""
    for face in range(low, high):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        ux, uy, uz = vertices[j, 0] - ax, vertices[j, 1] - ay, vertices[j, 2] - az
        vx, vy, vz = vertices[k, 0] - ax, vertices[k, 1] - ay, vertices[k, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        constant = nx * ax + ny * ay + nz * az
        side = FRONT if constant < 0.0 else 0
        bz, cz = vertices[j, 2], vertices[k, 2]
        if az <= 0.0 and bz <= 0.0 and cz <= 0.0:
            sides[face] = side | IGNORED
            continue
        reach = abs(ax) + abs(ay) + abs(az)
        rounding = _BLUR * reach * (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz))
        if abs(constant) <= _LEAST_COSINE * reach * (abs(nx) + abs(ny) + abs(nz)) + rounding:
            side |= IGNORED | EDGE_ON
        size = max(abs(ax), abs(ay), abs(vertices[j, 0]), abs(vertices[j, 1]))
        size = max(size, abs(vertices[k, 0]), abs(vertices[k, 1]))
        if not min(az, bz, cz) > _GRAZING * size:
            # Concurrent threads write the same value.
            large[0] = True
        sides[face] = side


def _to_cells(vertices: NDArray[np.float64], pinhole: tuple[float, float, float]) -> NDArray[np.float64]:
    """Project vertices into the image, in cells from its corner."""
    cells = np.empty((len(vertices), 2), dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for axis in range(2):
            place = pinhole[0] * vertices[:, axis] / vertices[:, 2]
            cells[:, axis] = (place + pinhole[1 + axis] + 0.5) / _CELL_PX
    return cells


@inlined
def _same(vertices: NDArray[np.float64], one: int, two: int) -> Any:
    """Return whether two vertices have the same position."""
    return one == two or (
        vertices[one, 0] == vertices[two, 0]
        and vertices[one, 1] == vertices[two, 1]
        and vertices[one, 2] == vertices[two, 2]
    )


@inlined
def _cell(value: float, count: int) -> Any:
    """Return the index of a cell, between -1 and ``count``."""
    # Compared as floats, because the cell of a distant point may overflow an integer.
    return int(np.floor(min(max(value, -1.0), float(count))))


def _find_boxes(
    cells: NDArray[np.float64], faces: NDArray[np.int32], sides: NDArray[np.uint8], face_offsets: NDArray[np.int64],
    rows: int, columns: int, boxes: NDArray[np.int32],
) -> None:  # fmt: skip
    """Find the cells over which each body may be."""
    for body, (begin, end) in enumerate(pairwise(face_offsets.tolist())):
        corners = faces[begin:end][sides[begin:end] & IGNORED == 0].ravel()
        if not len(corners):
            continue
        x, y = cells[:, 0].take(corners), cells[:, 1].take(corners)
        # These ignore NaN.
        left, right = float(np.fmin.reduce(x)), float(np.fmax.reduce(x))
        top, bottom = float(np.fmin.reduce(y)), float(np.fmax.reduce(y))
        if left <= right:
            first_column, last_column = max(_cell(left, columns), 0), min(_cell(right, columns), columns - 1)
            first_row, last_row = max(_cell(top, rows), 0), min(_cell(bottom, rows), rows - 1)
            boxes[body, :2] = first_row, first_column
            boxes[body, 2:] = max(last_row - first_row + 1, 0), max(last_column - first_column + 1, 0)


@kernel()
def _find_single(
    vertices: NDArray[np.float64], cells: NDArray[np.float64], faces: NDArray[np.int32],
    sides_across: NDArray[np.int32], sides: NDArray[np.uint8], face_offsets: NDArray[np.int64],
    boxes: NDArray[np.int32], starts: NDArray[np.int64], steps: NDArray[np.int32], single: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Find the cells of bodies with a single layer; all are marked as such before.

    ``steps``: Zeros, one for each cell and one more for each row, for what is to the right of it.
    """
    # Of one type from the first use on: kernels are compiled for every combination of types.
    begin = np.int64(0)
    for body in range(boxes.shape[0]):
        rows, columns = np.int64(boxes[body, 2]), np.int64(boxes[body, 3])
        if rows * columns == 0:
            continue
        first, last = face_offsets[body], face_offsets[body + 1]
        for face in range(first, last):
            side = sides[face]
            if side & IGNORED and not side & EDGE_ON:
                continue
            for k in range(3):
                i, j = faces[face, k], faces[face, (k + 1) % 3]
                other, m = sides_across[face, k] // 3, sides_across[face, k] % 3
                if first <= other < last and not (side | sides[other]) & IGNORED:
                    n, o = faces[other, m], faces[other, (m + 1) % 3]
                    if _same(vertices, i, o) and _same(vertices, j, n):
                        if side == sides[other]:
                            continue
                    elif side != sides[other] and _same(vertices, i, n) and _same(vertices, j, o):
                        continue
                # The inside of a front face is to the right of a side that runs down, that of a back face to its left.
                step = np.int64(1 if (side == FRONT) == (cells[j, 1] > cells[i, 1]) else -1)
                if side & IGNORED:
                    step = np.int64(0)
                _draw(cells, i, j, boxes[body], step, begin, steps, starts[body], single)
        for row in range(rows):
            layers, here = 0, starts[body] + row * columns
            for column in range(columns):
                layers += steps[begin + column]
                single[here + column] &= layers == 1
            # Otherwise rounding has moved the end of a side across the sampled line.
            if layers + steps[begin + columns] != 0:
                for column in range(columns):
                    single[here + column] = False
            begin += columns + 1


@subkernel()
def _draw(
    cells: NDArray[np.float64], i: int, j: int, box: NDArray[np.int32], step: int, begin: int, steps: NDArray[np.int32],
    start: int, single: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Unmark the cells that a side touches, and add a step of the number of layers where it crosses rows of cells."""
    x0, y0, x1, y1 = cells[i, 0] - box[1], cells[i, 1] - box[0], cells[j, 0] - box[1], cells[j, 1] - box[0]
    rows, columns = np.int64(box[2]), np.int64(box[3])
    margin = _MARGIN + _ROUNDING * (abs(x0) + abs(x1) + abs(y0) + abs(y1))
    low_x, high_x, low_y, high_y = min(x0, x1), max(x0, x1), min(y0, y1), max(y0, y1)
    slope = (x1 - x0) / (y1 - y0) if high_y - low_y > margin else 0.0
    for row in range(max(_cell(low_y - margin, rows), 0), min(_cell(high_y + margin, rows), rows - 1) + 1):
        left, right = low_x, high_x
        if high_y - low_y > margin:
            one = x0 + (max(row - margin, low_y) - y0) * slope
            two = x0 + (min(row + 1 + margin, high_y) - y0) * slope
            left, right = max(min(one, two), low_x), min(max(one, two), high_x)
        first, last = max(_cell(left - margin, columns), 0), min(_cell(right + margin, columns), columns - 1)
        middle = row + _SAMPLE
        if (y0 <= middle) != (y1 <= middle):
            steps[begin + row * (columns + 1) + first] += step
        for column in range(first, last + 1):
            single[start + row * columns + column] = False


@kernel()
def _find_nearest(
    vertices: NDArray[np.float64], cells: NDArray[np.float64], faces: NDArray[np.int32], sides: NDArray[np.uint8],
    face_offsets: NDArray[np.int64], pinhole: tuple[float, float, float], nearest: NDArray[np.float64],
    nearest_body: NDArray[np.int32],
) -> None:  # fmt: skip
    """Find the least depth of a body over each cell and of all others, as far as the planes of faces show it."""
    rows, columns = nearest_body.shape
    focal_px, centre_x, centre_y = pinhole
    for body in range(len(face_offsets) - 1):
        for face in range(face_offsets[body], face_offsets[body + 1]):
            side = sides[face]
            if side & IGNORED and not side & EDGE_ON:
                continue
            i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
            ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            x0, y0, x1, y1, x2, y2 = cells[i, 0], cells[i, 1], cells[j, 0], cells[j, 1], cells[k, 0], cells[k, 1]
            low_x, high_x, low_y, high_y = min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2)
            margin = _MARGIN + _ROUNDING * (abs(low_x) + abs(high_x) + abs(low_y) + abs(high_y))
            left, right = max(_cell(low_x - margin, columns), 0), min(_cell(high_x + margin, columns), columns - 1)
            top, bottom = max(_cell(low_y - margin, rows), 0), min(_cell(high_y + margin, rows), rows - 1)
            least = min(az, vertices[j, 2], vertices[k, 2])
            # The inverse of the depth is linear in the image.
            at_corner, along_x, along_y = 0.0, 0.0, 0.0
            if (right - left > 1 or bottom - top > 1) and not side & EDGE_ON:
                ux, uy, uz = vertices[j, 0] - ax, vertices[j, 1] - ay, vertices[j, 2] - az
                vx, vy, vz = vertices[k, 0] - ax, vertices[k, 1] - ay, vertices[k, 2] - az
                nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                constant = nx * ax + ny * ay + nz * az
                reach = abs(ax) + abs(ay) + abs(az)
                rounding = _BLUR * reach * (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz))
                if rounding < _LEAST_COSINE * abs(constant):
                    along_x, along_y = nx / constant / focal_px * _CELL_PX, ny / constant / focal_px * _CELL_PX
                    at_corner = nz / constant
                    at_corner -= (nx * (centre_x + 0.5) + ny * (centre_y + 0.5)) / constant / focal_px
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    depth = least
                    if at_corner != 0.0:
                        inverse = at_corner + max(along_x * column, along_x * (column + 1))
                        inverse += max(along_y * row, along_y * (row + 1))
                        if inverse > 0.0:
                            depth = max(depth, (1.0 - _SAFE) / inverse)
                    if nearest_body[row, column] == body:
                        nearest[row, column, 0] = min(nearest[row, column, 0], depth)
                    elif depth < nearest[row, column, 0]:
                        nearest[row, column, 1] = nearest[row, column, 0]
                        nearest[row, column, 0] = depth
                        nearest_body[row, column] = body
                    else:
                        nearest[row, column, 1] = min(nearest[row, column, 1], depth)

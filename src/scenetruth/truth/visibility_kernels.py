"""Kernels that decide in float64 which points on a mesh are occluded by its faces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.ray_triangle_kernels import PLANE_MARGIN, blurs, inside, within
from scenetruth.threads import in_bands

__all__ = ["Cells", "hide_points", "look_at_points", "place_points", "sort_into_cells"]

_TOUCH = 1e-9  # relative depth difference below which a face does not occlude a point (float64 rounding)
_MARGIN = 1e-9  # relative margin of the face bounding boxes for rounding
_GRAZING = 1e-6  # faces with a corner depth below this fraction of their size are assumed to cover the whole image
_MANY = 16  # faces that may occlude more points of a row than this are intersected with the row
_ROW_MARGIN = 1e-6  # relative tolerance by which points may exceed their cells due to rounding
_LEAST_POINTS, _LEAST_FACES = 8192, 1024  # minimum number of points and faces per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


@inlined
def _place(vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, b1: float, b2: float) -> Any:
    """Return a point on a face, and whether the front of the face is towards the origin."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ux, uy, uz = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
    vx, vy, vz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return (
        vertices[i, 0] + b1 * ux + b2 * vx,
        vertices[i, 1] + b1 * uy + b2 * vy,
        vertices[i, 2] + b1 * uz + b2 * vz,
        nx * vertices[i, 0] + ny * vertices[i, 1] + nz * vertices[i, 2] < 0.0,
    )


def place_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Compute points on faces, and whether the front of each face is towards the origin.

    ``vertices``: Positions in mm, shape (k, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``face``: Face of each point, shape (n,).
    ``weights``: Barycentric coordinates of the second and third corner, shape (n, 2).
    Returns: Points in mm, shape (n, 3); and whether the normal (p1 - p0) x (p2 - p0) points to the side of the origin,
    shape (n,).
    """
    count = face.shape[0]
    points = np.empty((count, 3), dtype=np.float64)
    towards = np.empty(count, dtype=np.bool_)
    in_bands(_place_points, count, vertices, faces, face, weights, points, towards, least=_LEAST_POINTS)
    return points, towards


@kernel()
def _place_points(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], points: NDArray[np.float64], towards: NDArray[np.bool_],
) -> None:  # fmt: skip
    for n in range(np.uint64(low), np.uint64(high)):
        x, y, z, front = _place(vertices, faces, face[n], weights[n, 0], weights[n, 1])
        points[n, 0], points[n, 1], points[n, 2], towards[n] = x, y, z, front


class Cells(NamedTuple):
    """Points in front of a camera, sorted into square cells of X / Z and Y / Z."""

    order: NDArray[np.int32]
    """Point indices in row-major cell order, shape (k,)."""
    places: NDArray[np.float64]
    """X, Y and Z of the sorted points, shape (3, k)."""
    own: NDArray[np.int32]
    """Faces of the sorted points, shape (k,)."""
    starts: NDArray[np.int32]
    """Start index of each cell, followed by k."""
    low_u: float
    """Lowest X / Z."""
    low_v: float
    """Lowest Y / Z."""
    edge: float
    """Side length of the cells."""
    columns: int
    """Number of cells along X / Z."""
    rows: int
    """Number of cells along Y / Z."""


def look_at_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
    sides: NDArray[np.bool_],
    focal_px: float,
    centre_x: float,
    centre_y: float,
    width: float,
    height: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Project points on faces into a pinhole camera and select those in its image with their side towards it.

    ``vertices``: Positions in the camera frame in mm, shape (k, 3).
    ``sides``: Whether each point is on the front of its face, shape (n,).
    ``focal_px``, ``centre_x``, ``centre_y``: Focal length and principal point in px.
    ``width``, ``height``: Size of the image in px, infinite to select points outside it as well.
    Returns: Points in mm, shape (n, 3); pixel coordinates, shape (n, 2), NaN behind the camera; and whether the points
    are in the image, in front of the camera, with their side towards it, shape (n,).
    """
    count = face.shape[0]
    points = np.empty((count, 3), dtype=np.float64)
    pixels = np.empty((count, 2), dtype=np.float64)
    turned = np.empty(count, dtype=np.bool_)
    out = (points, pixels, turned)
    # The first pixel centre is at 0.
    first = -0.5 if np.isfinite(width) else -np.inf
    camera = (focal_px, centre_x, centre_y, first, width - 0.5, height - 0.5)
    in_bands(_look_at_points, count, vertices, faces, face, weights, sides, camera, out, least=_LEAST_POINTS)
    return out


@kernel(error_model="numpy")
def _look_at_points(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], sides: NDArray[np.bool_], camera: tuple[float, ...], out: tuple[NDArray[Any], ...],
) -> None:  # fmt: skip
    focal_px, centre_x, centre_y, first, last_x, last_y = camera
    points, pixels, turned = out
    for n in range(np.uint64(low), np.uint64(high)):
        x, y, z, towards = _place(vertices, faces, face[n], weights[n, 0], weights[n, 1])
        points[n, 0], points[n, 1], points[n, 2] = x, y, z
        if z > 0.0:
            px, py = focal_px * x / z + centre_x, focal_px * y / z + centre_y
            pixels[n, 0], pixels[n, 1] = px, py
            turned[n] = towards == sides[n] and first <= px <= last_x and first <= py <= last_y
        else:
            pixels[n, 0] = pixels[n, 1] = np.nan
            turned[n] = False


@kernel()
def sort_into_cells(
    points: NDArray[np.float64], pixels: NDArray[np.float64], chosen: NDArray[np.bool_], face: NDArray[np.int32],
    focal_px: float, centre_x: float, centre_y: float,
) -> Any:  # fmt: skip
    """Sort chosen points in front of a pinhole camera (camera frame, mm), with their faces, into cells of its image."""
    count = 0
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    for n in range(np.uint64(points.shape[0])):
        if chosen[n]:
            x, y = pixels[n, 0], pixels[n, 1]
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
            count += 1
    if count == 0:
        low_x, high_x, low_y, high_y = 0.0, 0.0, 0.0, 0.0
    wide, high = high_x - low_x, high_y - low_y
    edge = max(1.0, np.sqrt(wide * high / max(count, 1) / 4.0), max(wide, high) / 1e5)
    inverse = 1.0 / edge
    columns, rows = int(wide * inverse) + 1, int(high * inverse) + 1
    starts = np.zeros(rows * columns + 1, dtype=np.int32)
    cells = np.empty(count, dtype=np.int32)
    used = np.uint64(0)
    for n in range(np.uint64(points.shape[0])):
        if chosen[n]:
            column = min(int((pixels[n, 0] - low_x) * inverse), columns - 1)
            row = min(int((pixels[n, 1] - low_y) * inverse), rows - 1)
            cell = np.uint64(row * columns + column)
            cells[used] = cell
            starts[cell + np.uint64(1)] += 1
            used += np.uint64(1)
    for k in range(rows * columns):
        starts[k + 1] += starts[k]
    place = starts[:-1].copy()
    order, own = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    places = np.empty((3, count), dtype=np.float64)
    used = np.uint64(0)
    for n in range(np.uint64(points.shape[0])):
        if chosen[n]:
            cell = np.uint64(cells[used])
            at = np.uint64(place[cell])
            order[at], own[at] = n, face[n]
            places[0, at], places[1, at], places[2, at] = points[n, 0], points[n, 1], points[n, 2]
            place[cell] += 1
            used += np.uint64(1)
    low_u, low_v = (low_x - centre_x) / focal_px, (low_y - centre_y) / focal_px
    return Cells(order, places, own, starts, low_u, low_v, edge / focal_px, columns, rows)


def hide_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    cells: Cells,
) -> NDArray[np.bool_]:
    """Compute which points are occluded by a face.

    A face occludes a point if the ray to the point hits the face (`scenetruth.raycast.ray_triangle_kernels.inside`)
    before the point. The face of the point itself is ignored.

    ``vertices``: Positions in the camera frame in mm, shape (k, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    Returns: bool, shape (n,), in cell order.
    """
    hidden = np.zeros(len(cells.own), dtype=np.bool_)
    count = faces.shape[0]
    # A face costs about as much as eight points; few faces that may occlude many points are also parallelised.
    least = _LEAST_FACES * 8 * count // (8 * count + len(cells.own) + 1)
    in_bands(_hide_points, count, vertices, faces, cells, hidden, least=max(least, 1))
    return hidden


@kernel(error_model="numpy")
def _hide_points(
    begin_face: int, end_face: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], cells: Cells,
    hidden: NDArray[np.bool_],
) -> None:  # fmt: skip
    low_u, low_v, edge, columns, rows = cells.low_u, cells.low_v, cells.edge, cells.columns, cells.rows
    starts, own, xs, ys, zs = cells.starts, cells.own, cells.places[0], cells.places[1], cells.places[2]
    largest = 1.0 + abs(low_u) + columns * edge + abs(low_v) + rows * edge
    for face in range(begin_face, end_face):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        bx, by, bz = vertices[j, 0], vertices[j, 1], vertices[j, 2]
        cx, cy, cz = vertices[k, 0], vertices[k, 1], vertices[k, 2]
        if az <= 0.0 and bz <= 0.0 and cz <= 0.0:
            continue
        nearest = min(az, bz, cz)
        size = max(max(abs(ax), abs(bx), abs(cx)), max(abs(ay), abs(by), abs(cy)))
        left, right, top, bottom = 0, columns - 1, 0, rows - 1
        if nearest > _GRAZING * size:
            lowest_u, highest_u = min(ax / az, bx / bz, cx / cz), max(ax / az, bx / bz, cx / cz)
            lowest_v, highest_v = min(ay / az, by / bz, cy / cz), max(ay / az, by / bz, cy / cz)
            margin = _MARGIN * (1.0 + max(abs(lowest_u), abs(highest_u), abs(lowest_v), abs(highest_v)))
            # Compared as floats, because the cell of a distant face may overflow an integer.
            first, last = (lowest_u - margin - low_u) / edge, (highest_u + margin - low_u) / edge
            upper, lower = (lowest_v - margin - low_v) / edge, (highest_v + margin - low_v) / edge
            if last < 0.0 or lower < 0.0 or first >= columns or upper >= rows:
                continue
            left, right = int(max(first, 0.0)), int(min(last, columns - 1.0))
            top, bottom = int(max(upper, 0.0)), int(min(lower, rows - 1.0))
        abx, aby, abz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        cax, cay, caz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        ux, uy, uz = bx - ax, by - ay, bz - az
        vx, vy, vz = cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        constant = nx * ax + ny * ay + nz * az
        blur_x, blur_y, blur_z = blurs(ax, ay, az, bx, by, bz, cx, cy, cz)
        blurred = blur_x + blur_y + blur_z
        ab = (PLANE_MARGIN * np.sqrt(abx * abx + aby * aby + abz * abz) + blurred) * largest
        bc = (PLANE_MARGIN * np.sqrt(bcx * bcx + bcy * bcy + bcz * bcz) + blurred) * largest
        ca = (PLANE_MARGIN * np.sqrt(cax * cax + cay * cay + caz * caz) + blurred) * largest
        for row in range(top, bottom + 1):
            begin, end = starts[row * columns + left], starts[row * columns + right + 1]
            if end - begin > _MANY:
                # Long oblique faces touch only a part of the cells of their bounding box.
                low, high = np.inf, -np.inf
                first_v = low_v + (row - _ROW_MARGIN) * edge
                last_v = low_v + (row + 1 + _ROW_MARGIN) * edge
                for side in (1.0, -1.0):
                    lowest, highest = -np.inf, np.inf
                    lowest, highest = within(side * bcx, side * bcy, side * bcz, bc, first_v, last_v, lowest, highest)
                    lowest, highest = within(side * cax, side * cay, side * caz, ca, first_v, last_v, lowest, highest)
                    lowest, highest = within(side * abx, side * aby, side * abz, ab, first_v, last_v, lowest, highest)
                    if lowest <= highest:
                        low, high = min(low, lowest), max(high, highest)
                first, last = (low - low_u) / edge - _ROW_MARGIN, (high - low_u) / edge + _ROW_MARGIN
                if not low <= high or last < left or first >= right + 1:
                    continue
                begin = starts[row * columns + max(left, int(max(first, 0.0)))]
                end = starts[row * columns + min(right, int(min(last, columns - 1.0))) + 1]
            for n in range(begin, end):
                px, py, pz = xs[n], ys[n], zs[n]
                w0 = px * bcx + py * bcy + pz * bcz
                w1 = px * cax + py * cay + pz * caz
                w2 = px * abx + py * aby + pz * abz
                blur = abs(px) * blur_x + abs(py) * blur_y + abs(pz) * blur_z
                # One branch that is seldom taken: several are predicted wrongly at most points.
                near = (min(w0, w1, w2) >= -blur) | (max(w0, w1, w2) <= blur)
                if not (near & (nearest < pz) & (own[n] != face)) or hidden[n]:
                    continue
                if not inside(w0, w1, w2, blur):
                    continue
                slope = nx * px + ny * py + nz * pz
                if slope == 0.0:
                    continue
                share = constant / slope
                # Concurrent threads write the same value.
                if share > 0.0 and share < 1.0 - _TOUCH:
                    hidden[n] = True

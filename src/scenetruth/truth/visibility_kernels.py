"""Kernels that decide in float64 which points on a mesh are occluded by its faces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.ray_triangle_kernels import PLANE_MARGIN, blurs, inside, within
from scenetruth.threads import in_bands
from scenetruth.truth.layer_kernels import FRONT, IGNORED, Layers, are_clear

__all__ = ["Cells", "Runs", "Views", "find_runs", "hide_points", "look_at_points", "place_points", "sort_into_cells"]

_TOUCH = 1e-9  # relative depth difference below which a face does not occlude a point (float64 rounding)
_MARGIN = 1e-9  # relative margin of the face bounding boxes for rounding
_GRAZING = 1e-6  # faces with a corner depth below this fraction of their size are assumed to cover the whole image
_MANY = 16  # faces that may occlude more points of a row than this are intersected with the row
_ROW_MARGIN = 1e-6  # relative tolerance by which points may exceed their cells due to rounding
_SHORTEST_RUN, _LONGEST_RUN = 6, 32  # numbers of points of runs that are projected as a whole
_LEAST_RUNS = 1024  # minimum number of runs per thread
_LEAST_POINTS, _LEAST_FACES = 8192, 1024  # minimum number of points and faces per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


@inlined
def _place(vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, b1: float, b2: float) -> Any:
    """Return a point on a face."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ux, uy, uz = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
    vx, vy, vz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
    return (
        vertices[i, 0] + b1 * ux + b2 * vx,
        vertices[i, 1] + b1 * uy + b2 * vy,
        vertices[i, 2] + b1 * uz + b2 * vz,
    )


def place_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Compute points on faces, in mm, shape (n, 3).

    ``vertices``: Positions in mm, shape (k, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``face``: Face of each point, shape (n,).
    ``weights``: Barycentric coordinates of the second and third corner, shape (n, 2).
    """
    count = face.shape[0]
    points = np.empty((count, 3), dtype=np.float64)
    in_bands(_place_points, count, vertices, faces, face, weights, points, least=_LEAST_POINTS)
    return points


@kernel()
def _place_points(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], points: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(np.uint64(low), np.uint64(high)):
        x, y, z = _place(vertices, faces, face[n], weights[n, 0], weights[n, 1])
        points[n, 0], points[n, 1], points[n, 2] = x, y, z


class Cells(NamedTuple):
    """Points in front of a camera, sorted into square cells of X / Z and Y / Z."""

    order: NDArray[np.int64]
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


class Runs(NamedTuple):
    """Runs of successive points on the same face, in parallelograms of their barycentric coordinates."""

    starts: NDArray[np.int32]
    """Index of the first point of each run, followed by the number of points, shape (runs + 1,)."""
    corners: NDArray[np.float64]
    """Barycentric coordinates of the corners of the parallelograms, shape (runs, 4, 2)."""


@kernel()
def find_runs(face: NDArray[np.int32], weights: NDArray[np.float64]) -> Any:
    """Find the runs of points on faces, shape (n,), with barycentric coordinates, shape (n, 2)."""
    count = np.int64(face.shape[0])
    runs, begin = 0, 0
    for n in range(1, count + 1):
        if n == count or face[n] != face[begin] or n - begin == _LONGEST_RUN:
            runs, begin = runs + 1, n
    starts, corners = np.empty(runs + 1, dtype=np.int32), np.empty((runs, 4, 2), dtype=np.float64)
    run, begin = 0, 0
    for end in range(1, count + 1):
        if not (end == count or face[end] != face[begin] or end - begin == _LONGEST_RUN):
            continue
        starts[run] = begin
        if end - begin >= _SHORTEST_RUN:
            # Pixels along a row are on a line: along the coordinate that changes most, at offsets of rounding from it.
            right, below = weights[end - 1, 0] - weights[begin, 0], weights[end - 1, 1] - weights[begin, 1]
            along = 0 if abs(right) >= abs(below) else 1
            change, other = (right, below) if along == 0 else (below, right)
            slope = other / change if change != 0.0 else 0.0
            low, high, least, most = np.inf, -np.inf, np.inf, -np.inf
            for n in range(begin, end):
                place = weights[n, along]
                offset = weights[n, 1 - along] - slope * place
                low, high, least, most = min(low, place), max(high, place), min(least, offset), max(most, offset)
            for corner in range(4):
                place, offset = low if corner < 2 else high, least if corner % 2 == 0 else most
                corners[run, corner, along], corners[run, corner, 1 - along] = place, slope * place + offset
        run, begin = run + 1, end
    starts[run] = count
    return Runs(starts, corners)


class Views(NamedTuple):
    """Points on faces as a pinhole camera sees them."""

    places: NDArray[np.float64]
    """Positions in the camera frame in mm, shape (n, 3); shape (0, 3) if they are not wanted."""
    pixels: NDArray[np.float64]
    """Pixel coordinates, NaN behind the camera, shape (n, 2); shape (0, 2) if they are not wanted."""
    seen: NDArray[np.bool_]
    """Whether each point is in the image, in front of the camera, with its side towards it, shape (n,)."""
    unsure: NDArray[np.bool_]
    """Which of them may be occluded by a face, shape (n,)."""


def look_at_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
    fronts: NDArray[np.bool_],
    face_body: NDArray[np.int32],
    runs: Runs,
    layers: Layers,
    pinhole: tuple[float, float, float],
    size: tuple[float, float],
    *,
    with_pixels: bool,
    with_places: bool,
) -> Views:
    """Project points on faces into a pinhole camera and select those in its image with their side towards it.

    ``vertices``: Positions in the camera frame in mm, shape (k, 3).
    ``fronts``: Whether each point is on the front of its face, shape (n,).
    ``face_body``: Body index of each face, shape (m,).
    ``runs``: Runs of these points, which are selected as a whole where possible.
    ``pinhole``: Focal length and principal point in px.
    ``size``: Width and height of the image in px, infinite to select points outside it as well.
    """
    count = face.shape[0]
    out = Views(
        np.empty((count if with_places else 0, 3), dtype=np.float64),
        np.empty((count if with_pixels else 0, 2), dtype=np.float64),
        np.empty(count, dtype=np.bool_),
        np.empty(count, dtype=np.bool_),
    )
    # The first pixel centre is at 0.
    first = -0.5 if np.isfinite(size[0]) else -np.inf
    camera = (*pinhole, first, size[0] - 0.5, size[1] - 0.5)
    given = (vertices, faces, face, weights, fronts, face_body, layers, camera, out)
    if with_places or with_pixels:
        in_bands(_look_at_points, count, *given, least=_LEAST_POINTS)
    else:
        in_bands(_look_at_runs, len(runs.corners), *given, runs, least=_LEAST_RUNS)
    return out


@kernel()
def _look_at_points(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], fronts: NDArray[np.bool_], face_body: NDArray[np.int32], layers: Layers,
    camera: tuple[float, ...], out: Views,
) -> None:  # fmt: skip
    focal_px, centre_x, centre_y, first, last_x, last_y = camera
    places, pixels, seen, unsure = out
    boxes, nearest, nearest_body = layers.boxes, layers.nearest, layers.nearest_body
    sides, inverse, several = layers.sides, layers.inverse, nearest_body.size > 1
    body, top, left, rows, columns, start = -1, 0, 0, 0, 0, 0
    with_places, with_pixels = places.shape[0] > 0, pixels.shape[0] > 0
    known, front = np.int32(-1), False
    ax, ay, az, ux, uy, uz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(np.uint64(low), np.uint64(high)):
        own = face[n]
        # Most points are on the face of the point before.
        if own != known:
            known = own
            i, j, k = faces[own, 0], faces[own, 1], faces[own, 2]
            ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            ux, uy, uz = vertices[j, 0] - ax, vertices[j, 1] - ay, vertices[j, 2] - az
            vx, vy, vz = vertices[k, 0] - ax, vertices[k, 1] - ay, vertices[k, 2] - az
            front, body = sides[own] & FRONT != 0, face_body[own]
            top, left, rows, columns = 0, 0, 0, 0
            if not sides[own] & IGNORED and layers.single.size > 0:
                top, left, rows, columns = boxes[body, 0], boxes[body, 1], boxes[body, 2], boxes[body, 3]
                start = layers.starts[body]
        turned = front == fronts[n]
        if not (turned or with_places or with_pixels):
            seen[n] = unsure[n] = False
            continue
        b1, b2 = weights[n, 0], weights[n, 1]
        x, y, z = ax + b1 * ux + b2 * vx, ay + b1 * uy + b2 * vy, az + b1 * uz + b2 * vz
        if with_places:
            places[n, 0], places[n, 1], places[n, 2] = x, y, z
        px, py = np.nan, np.nan
        if z > 0.0:
            px, py = focal_px * x / z + centre_x, focal_px * y / z + centre_y
        if with_pixels:
            pixels[n, 0], pixels[n, 1] = px, py
        # Comparisons with NaN are false.
        here = turned & (first <= px) & (px <= last_x) & (first <= py) & (py <= last_y)
        seen[n] = here
        unsure[n] = here
        if not here:
            continue
        across, down = (px + 0.5) * inverse, (py + 0.5) * inverse
        column, row = across - left, down - top
        inside = (min(across, column) >= 0.0) & (column < columns) & (min(down, row) >= 0.0) & (row < rows)
        if inside and layers.single[np.uint64(start + int(row) * columns + int(column))]:
            behind = np.inf
            if several:
                m, o = np.uint64(down), np.uint64(across)
                behind = nearest[m, o, 1 if nearest_body[m, o] == body else 0]
            unsure[n] = not z < behind


@kernel()
def _look_at_runs(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], fronts: NDArray[np.bool_], face_body: NDArray[np.int32], layers: Layers,
    camera: tuple[float, ...], out: Views, runs: Runs,
) -> None:  # fmt: skip
    """Select points run by run, as far as all points of a run are alike."""
    focal_px, centre_x, centre_y = camera[0], camera[1], camera[2]
    inverse, sides, seen, unsure = layers.inverse, layers.sides, out.seen, out.unsure
    pending = np.uint64(runs.starts[low])  # first point that is not decided yet
    last = np.uint64(high)
    # The point after the last run ends what is not decided, so that there is one call to compile.
    for run in range(np.uint64(low), last + np.uint64(1)):
        begin = np.uint64(runs.starts[run])
        end, turned = begin, False
        if run < last:
            end, own = np.uint64(runs.starts[run + np.uint64(1)]), face[begin]
            # All points of a run are on the same side of their face.
            turned = (sides[own] & FRONT != 0) == fronts[begin]
            clear = False
            if turned and not sides[own] & IGNORED and end - begin >= np.uint64(_SHORTEST_RUN):
                low_x, high_x, low_y, high_y, depth, least = np.inf, -np.inf, np.inf, -np.inf, 0.0, np.inf
                for corner in range(4):
                    x, y, z = _place(vertices, faces, own, runs.corners[run, corner, 0], runs.corners[run, corner, 1])
                    px, py = focal_px * x / z + centre_x, focal_px * y / z + centre_y
                    low_x, high_x, low_y, high_y = min(low_x, px), max(high_x, px), min(low_y, py), max(high_y, py)
                    depth, least = max(depth, z), min(least, z)
                low_x, high_x = (low_x + 0.5) * inverse, (high_x + 0.5) * inverse
                low_y, high_y = (low_y + 0.5) * inverse, (high_y + 0.5) * inverse
                clear = least > 0.0 and are_clear(layers, face_body[own], low_x, high_x, low_y, high_y, depth)
            if turned and not clear:
                continue
        if pending < begin:
            _look_at_points(pending, begin, vertices, faces, face, weights, fronts, face_body, layers, camera, out)
        pending = end
        for n in range(begin, end):
            seen[n] = turned
            unsure[n] = False


@kernel()
def sort_into_cells(
    chosen: NDArray[np.int64], vertices: NDArray[np.float64], faces: NDArray[np.int32], face: NDArray[np.int32],
    weights: NDArray[np.float64], focal_px: float, centre_x: float, centre_y: float,
) -> Any:  # fmt: skip
    """Sort chosen points on faces, in front of a pinhole camera (camera frame, mm), into cells of its image."""
    count = chosen.shape[0]
    points, pixels = np.empty((count, 3), dtype=np.float64), np.empty((count, 2), dtype=np.float64)
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    for m in range(np.uint64(count)):
        n = np.uint64(chosen[m])
        x, y, z = _place(vertices, faces, face[n], weights[n, 0], weights[n, 1])
        points[m, 0], points[m, 1], points[m, 2] = x, y, z
        x, y = focal_px * x / z + centre_x, focal_px * y / z + centre_y
        pixels[m, 0], pixels[m, 1] = x, y
        low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
    if count == 0:
        low_x, high_x, low_y, high_y = 0.0, 0.0, 0.0, 0.0
    wide, high = high_x - low_x, high_y - low_y
    edge = max(1.0, np.sqrt(wide * high / max(count, 1) / 4.0), max(wide, high) / 1e5)
    inverse = 1.0 / edge
    columns, rows = int(wide * inverse) + 1, int(high * inverse) + 1
    starts, place = np.empty(rows * columns + 1, dtype=np.int32), np.empty(rows * columns, dtype=np.int32)
    cells = np.empty(count, dtype=np.int32)
    for k in range(rows * columns + 1):
        starts[k] = 0
    for m in range(np.uint64(count)):
        column = min(int((pixels[m, 0] - low_x) * inverse), columns - 1)
        row = min(int((pixels[m, 1] - low_y) * inverse), rows - 1)
        cell = np.uint64(row * columns + column)
        cells[m] = cell
        starts[cell + np.uint64(1)] += 1
    for k in range(rows * columns):
        place[k] = starts[k]
        starts[k + 1] += starts[k]
    order, own = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int32)
    places = np.empty((3, count), dtype=np.float64)
    for m in range(np.uint64(count)):
        cell = np.uint64(cells[m])
        at = np.uint64(place[cell])
        order[at], own[at] = chosen[m], face[chosen[m]]
        places[0, at], places[1, at], places[2, at] = points[m, 0], points[m, 1], points[m, 2]
        place[cell] += 1
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


@kernel()
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
        # Most faces are over cells without points.
        for row in range(top, bottom + 1):
            if starts[row * columns + left] != starts[row * columns + right + 1]:
                break
        else:
            continue
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

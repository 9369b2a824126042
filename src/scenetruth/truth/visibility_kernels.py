"""Kernels that tell which points on a mesh are hidden by one of its faces, in float64."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.inside_kernels import blurs, inside

__all__ = ["hide_points", "place_points", "sort_into_cells"]

# A face that is nearer to the camera by less than this share of the point's depth does not hide it: float64 rounding.
_TOUCH = 1e-9
# The boxes around faces are wider by this share, for rounding.
_MARGIN = 1e-9
# Faces with a corner whose depth is less than this share of their size may be anywhere in the image.
_GRAZING = 1e-6


@numba.njit(cache=True, nogil=True, parallel=True)
def place_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> Any:
    """Compute points on faces, and tell which faces show their front to the origin.

    Parameters
    ----------
    vertices
        Positions in mm, shape (k, 3).
    faces
        Corners of the faces, shape (m, 3).
    face
        The face on which each point lies, shape (n,).
    weights
        Barycentric coordinates of the face's second and third corner, shape (n, 2).

    Returns
    -------
    tuple of numpy.ndarray
        Points in mm, shape (n, 3); and whether the normal (p1 - p0) x (p2 - p0) of their face points to the side on
        which the origin lies, shape (n,).
    """
    count = face.shape[0]
    points = np.empty((count, 3), dtype=np.float64)
    towards = np.empty(count, dtype=np.bool_)
    for n in numba.prange(count):
        i, j, k = faces[face[n], 0], faces[face[n], 1], faces[face[n], 2]
        ux, uy, uz = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
        vx, vy, vz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
        b1, b2 = weights[n, 0], weights[n, 1]
        points[n, 0] = vertices[i, 0] + b1 * ux + b2 * vx
        points[n, 1] = vertices[i, 1] + b1 * uy + b2 * vy
        points[n, 2] = vertices[i, 2] + b1 * uz + b2 * vz
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        towards[n] = nx * vertices[i, 0] + ny * vertices[i, 1] + nz * vertices[i, 2] < 0.0
    return points, towards


@numba.njit(cache=True, nogil=True)
def sort_into_cells(
    u: NDArray[np.float64], v: NDArray[np.float64], low: NDArray[np.float64], cell: float, columns: int, rows: int
) -> Any:
    """Sort points of a plane into square cells.

    Parameters
    ----------
    u, v
        Coordinates of the points, shape (n,).
    low
        Lowest u and v, shape (2,).
    cell
        Edge of the cells.
    columns, rows
        Number of cells along u and along v; points outside belong to the nearest cell.

    Returns
    -------
    tuple of numpy.ndarray
        Indices of the points in the order of their cells, row by row, shape (n,); and where each cell begins in this
        order, then n, shape (rows * columns + 1,).
    """
    count = u.shape[0]
    starts = np.zeros(rows * columns + 1, dtype=np.int64)
    cells = np.empty(count, dtype=np.int64)
    for n in range(count):
        column = min(max(int((u[n] - low[0]) / cell), 0), columns - 1)
        row = min(max(int((v[n] - low[1]) / cell), 0), rows - 1)
        cells[n] = row * columns + column
        starts[cells[n] + 1] += 1
    for k in range(rows * columns):
        starts[k + 1] += starts[k]
    place = starts[:-1].copy()
    order = np.empty(count, dtype=np.int64)
    for n in range(count):
        order[place[cells[n]]] = n
        place[cells[n]] += 1
    return order, starts


@numba.njit(cache=True, nogil=True, parallel=True)
def hide_points(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    points: NDArray[np.float64],
    own: NDArray[np.int32],
    starts: NDArray[np.int64],
    order: NDArray[np.int64],
    low: NDArray[np.float64],
    cell: float,
    columns: int,
    rows: int,
) -> Any:
    """Tell which points are hidden from the camera by a face.

    A face hides a point if the ray to the point meets the face (`scenetruth.raycast.inside_kernels.inside`) before the
    point. A point's own face does not hide it.

    Parameters
    ----------
    vertices
        Positions in the camera's frame in mm, shape (k, 3).
    faces
        Corners of the faces, shape (m, 3).
    points
        Points in the camera's frame in mm, with Z > 0, shape (n, 3).
    own
        The face on which each point lies, shape (n,).
    starts, order
        The points' cells in X / Z and Y / Z, as `sort_into_cells` returns them.
    low, cell, columns, rows
        The cells, as of `sort_into_cells`.

    Returns
    -------
    numpy.ndarray
        bool, shape (n,).
    """
    hidden = np.zeros(points.shape[0], dtype=np.bool_)
    for face in numba.prange(faces.shape[0]):
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
            low_u, high_u = min(ax / az, bx / bz, cx / cz), max(ax / az, bx / bz, cx / cz)
            low_v, high_v = min(ay / az, by / bz, cy / cz), max(ay / az, by / bz, cy / cz)
            margin = _MARGIN * (1.0 + max(abs(low_u), abs(high_u), abs(low_v), abs(high_v)))
            # Compared as floats: the cell of a face far outside may be too large for an integer.
            first, last = (low_u - margin - low[0]) / cell, (high_u + margin - low[0]) / cell
            upper, lower = (low_v - margin - low[1]) / cell, (high_v + margin - low[1]) / cell
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
        for row in range(top, bottom + 1):
            for entry in range(starts[row * columns + left], starts[row * columns + right + 1]):
                n = order[entry]
                if hidden[n] or own[n] == face:
                    continue
                px, py, pz = points[n, 0], points[n, 1], points[n, 2]
                if nearest >= pz:
                    continue
                w0 = px * bcx + py * bcy + pz * bcz
                w1 = px * cax + py * cay + pz * caz
                w2 = px * abx + py * aby + pz * abz
                if not inside(w0, w1, w2, abs(px) * blur_x + abs(py) * blur_y + abs(pz) * blur_z):
                    continue
                slope = nx * px + ny * py + nz * pz
                if slope == 0.0:
                    continue
                share = constant / slope
                # Threads that write at the same time write the same value.
                if share > 0.0 and share < 1.0 - _TOUCH:
                    hidden[n] = True
    return hidden

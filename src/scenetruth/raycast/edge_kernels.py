"""Kernels that detect silhouette edges and creases and split them into segments in the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.threads import in_bands

__all__ = ["contour_edges", "cut_segments", "face_sides", "sort_first"]

_LEAST = 4096  # minimum number of faces or edges per thread


def face_sides(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], origin: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Compute face normals and whether each face has its front towards a point.

    ``vertices``: World positions in mm, shape (n, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``origin``: The point, in mm, shape (3,).
    Returns: Unit normals along (p1 - p0) x (p2 - p0), shape (m, 3); and whether the point is on the side of the normal,
    shape (m,).
    """
    count = faces.shape[0]
    normals = np.empty((count, 3), dtype=np.float64)
    front = np.empty(count, dtype=np.bool_)
    in_bands(_face_sides, count, vertices, faces, origin, normals, front, least=_LEAST)
    return normals, front


@kernel()
def _face_sides(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], origin: NDArray[np.float64],
    normals: NDArray[np.float64], front: NDArray[np.bool_],
) -> None:  # fmt: skip
    for face in range(low, high):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        ux, uy, uz = vertices[j, 0] - ax, vertices[j, 1] - ay, vertices[j, 2] - az
        vx, vy, vz = vertices[k, 0] - ax, vertices[k, 1] - ay, vertices[k, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
        nx, ny, nz = nx / length, ny / length, nz / length
        normals[face, 0], normals[face, 1], normals[face, 2] = nx, ny, nz
        front[face] = nx * (origin[0] - ax) + ny * (origin[1] - ay) + nz * (origin[2] - az) > 0.0


def contour_edges(
    normals: NDArray[np.float64],
    front: NDArray[np.bool_],
    edge_faces: NDArray[np.int32],
    flipped: NDArray[np.bool_],
    crowded: NDArray[np.bool_],
    crease_cosine: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Select boundary, silhouette and sharp edges, and edges with more than two faces; bool, shape (k,)."""
    count = edge_faces.shape[0]
    chosen = np.empty(count, dtype=np.bool_)
    in_bands(_contour_edges, count, normals, front, edge_faces, flipped, crowded, crease_cosine, chosen, least=_LEAST)
    return chosen


@kernel()
def _contour_edges(
    low: int, high: int, normals: NDArray[np.float64], front: NDArray[np.bool_], edge_faces: NDArray[np.int32],
    flipped: NDArray[np.bool_], crowded: NDArray[np.bool_], crease_cosine: NDArray[np.float64],
    chosen: NDArray[np.bool_],
) -> None:  # fmt: skip
    for edge in range(low, high):
        one, two = edge_faces[edge, 0], edge_faces[edge, 1]
        if two < 0 or crowded[edge]:
            chosen[edge] = True
            continue
        cosine = (
            normals[one, 0] * normals[two, 0] + normals[one, 1] * normals[two, 1] + normals[one, 2] * normals[two, 2]
        )
        if flipped[edge]:
            cosine = -cosine
        turned = (front[one] != front[two]) != flipped[edge]
        chosen[edge] = turned or cosine < crease_cosine[edge]


@inlined
def sort_first(values: NDArray[np.float64], count: int) -> None:
    """Sort the first few values in place by insertion; numba's sort takes longer to compile than the other kernels."""
    for n in range(1, count):
        value, at = values[n], n
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value


@kernel()
def cut_segments(
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    inverse_first: NDArray[np.float64],
    inverse_last: NDArray[np.float64],
    chosen: NDArray[np.int64],
    enter: NDArray[np.float64],
    leave: NDArray[np.float64],
    piece: float,
) -> Any:
    """Split image segments at the pixel borders, or into short equal pieces.

    ``first``, ``last``: Ends of the segments in px, shape (n, 2).
    ``inverse_first``, ``inverse_last``: 1 / Z at these ends, in 1/mm, shape (n,).
    ``enter``, ``leave``: Range of the segment that is split, as fractions from the first (0) to the last end (1), shape
      (n,).
    ``piece``: Maximum length of the pieces in px; 0 splits at the pixel borders, at half-integer coordinates.
    Returns: For the midpoint of every piece, in order along each segment: 1 / Z, shape (k,); position in px, shape (k,
    2); and segment index, shape (k,). 1 / Z is linear along a segment in the image.
    """
    most, total = 0, 0
    for n in chosen:
        count = _cuts(first[n], last[n], enter[n], leave[n], piece, np.empty(0, dtype=np.float64))
        most, total = max(most, count), total + count - 1
    inverses = np.empty(total, dtype=np.float64)
    positions = np.empty((total, 2), dtype=np.float64)
    segments = np.empty(total, dtype=np.int64)
    scratch = np.empty(most, dtype=np.float64)
    used = 0
    for n in chosen:
        count = _cuts(first[n], last[n], enter[n], leave[n], piece, scratch)
        sort_first(scratch, count)
        for k in range(count - 1):
            middle = (scratch[k] + scratch[k + 1]) / 2
            inverses[used] = inverse_first[n] + middle * (inverse_last[n] - inverse_first[n])
            positions[used, 0] = first[n, 0] + middle * (last[n, 0] - first[n, 0])
            positions[used, 1] = first[n, 1] + middle * (last[n, 1] - first[n, 1])
            segments[used] = n
            used += 1
    return inverses, positions, segments


@subkernel()
def _cuts(
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    enter: float,
    leave: float,
    piece: float,
    out: NDArray[np.float64],
) -> int:
    """Write the unsorted fractions at which a segment is split; return their number (``out`` of size 0 only counts)."""
    room = out.shape[0] > 0
    count = 2
    if room:
        out[0], out[1] = enter, leave
    if piece > 0:
        length = np.hypot(last[0] - first[0], last[1] - first[1]) * (leave - enter)
        parts = int(np.ceil(length / piece))
        for k in range(1, parts):
            if room:
                out[count] = min(max(k * ((leave - enter) / parts) + enter, enter), leave)
            count += 1
        return count
    for axis in range(2):
        step = last[axis] - first[axis]
        if step == 0:
            continue
        one, two = first[axis] + enter * step, first[axis] + leave * step
        border, end = np.ceil(min(one, two) - 0.5), np.floor(max(one, two) - 0.5)
        while border <= end:
            if room:
                out[count] = min(max((border + 0.5 - first[axis]) / step, enter), leave)
            border += 1
            count += 1
    return count

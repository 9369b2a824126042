"""Kernels for ground-truth maps: ray hits, curvature, growth, and distance to the nearest marked pixel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel
from scenetruth.scene.surface_tensor_kernels import (
    CURVATURE,
    DEFORMATION,
    NORMAL,
    ROTATION,
    TENSOR_COLUMNS,
    TENSOR_ROWS,
    WIDTH,
)
from scenetruth.threads import in_bands

__all__ = ["MovingMesh", "distances", "fill_maps", "fill_surface_maps"]


_LEAST = 4096  # minimum number of pixels per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


class MovingMesh(NamedTuple):
    """Mesh and its motion; vectors in the camera frame."""

    faces: NDArray[np.int32]
    """Vertex indices of the faces, shape (m, 3)."""
    velocities: NDArray[np.float64]
    """Velocities of the vertices in mm per frame, shape (n, 3)."""
    normals: NDArray[np.float64]
    """Unit normals of the faces, shape (m, 3)."""
    face_body: NDArray[np.int32]
    """Body index of each face, shape (m,)."""
    face_offsets: NDArray[np.int64]
    """Index of the first face of each body."""


def fill_maps(
    face: NDArray[np.int32],
    depth: NDArray[np.float64],
    weights: NDArray[np.float64],
    directions: NDArray[np.float64],
    mesh: MovingMesh,
    scale: float,
    disparity_depth: float,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int32],
    NDArray[np.int32],
]:
    """Compute velocity, rates, disparity, normal, object and face of every pixel.

    ``directions``: Ray directions in the camera frame, with Z = 1, shape (k, 3).
    ``scale``: Factor of the rates of X / Z and Y / Z: the focal length in px, or 1.
    ``disparity_depth``: Product of disparity and depth, f V_X, in px mm.
    Returns: Velocity, shape (3, k); rates, (2, k); disparity, (k,); normal, (3, k), towards the camera; object and face
    within the object, (k,). NaN and -1 for rays without a hit.
    """
    count = face.shape[0]
    velocity = np.empty((3, count), dtype=np.float64)
    rates = np.empty((2, count), dtype=np.float64)
    disparity = np.empty(count, dtype=np.float64)
    normal = np.empty((3, count), dtype=np.float64)
    body = np.empty(count, dtype=np.int32)
    own_face = np.empty(count, dtype=np.int32)
    out = (velocity, rates, disparity, normal, body, own_face)
    in_bands(_fill_maps, count, face, depth, weights, directions, mesh, scale, disparity_depth, out, least=_LEAST)
    return out


@kernel()
def _fill_maps(
    low: int, high: int, face: NDArray[np.int32], depth: NDArray[np.float64], weights: NDArray[np.float64],
    directions: NDArray[np.float64], mesh: MovingMesh, scale: float, disparity_depth: float,
    out: tuple[NDArray[Any], ...],
) -> None:  # fmt: skip
    faces, velocities, normals = mesh.faces, mesh.velocities, mesh.normals
    face_body, face_offsets = mesh.face_body, mesh.face_offsets
    velocity, rates, disparity, normal, body, own_face = out
    for n in range(np.uint64(low), np.uint64(high)):
        met = face[n]
        if met < 0:
            for k in range(3):
                velocity[k, n] = normal[k, n] = np.nan
            rates[0, n] = rates[1, n] = disparity[n] = np.nan
            body[n] = own_face[n] = -1
            continue
        first, second, third = faces[met, 0], faces[met, 1], faces[met, 2]
        b1, b2, z = weights[n, 0], weights[n, 1], depth[n]
        # first + b1 (second - first) + ... reproduces a velocity common to all corners exactly.
        ux = velocities[first, 0]
        ux += b1 * (velocities[second, 0] - velocities[first, 0]) + b2 * (velocities[third, 0] - velocities[first, 0])
        uy = velocities[first, 1]
        uy += b1 * (velocities[second, 1] - velocities[first, 1]) + b2 * (velocities[third, 1] - velocities[first, 1])
        uz = velocities[first, 2]
        uz += b1 * (velocities[second, 2] - velocities[first, 2]) + b2 * (velocities[third, 2] - velocities[first, 2])
        velocity[0, n], velocity[1, n], velocity[2, n] = ux, uy, uz
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        rates[0, n] = scale * ((ux - dx * uz) / z)
        rates[1, n] = scale * ((uy - dy * uz) / z)
        disparity[n] = disparity_depth / z
        nx, ny, nz = normals[met, 0], normals[met, 1], normals[met, 2]
        sign = -1.0 if nx * dx + ny * dy + nz * dz > 0.0 else 1.0
        normal[0, n], normal[1, n], normal[2, n] = sign * nx, sign * ny, sign * nz
        body[n] = face_body[met]
        own_face[n] = met - face_offsets[face_body[met]]


_EQUAL = 1e-9  # relative difference of principal rates below which their directions are undefined
_LEAST_POINTS = 1024  # minimum number of pixels per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


@subkernel()
def _tangential(tensors: Any, first: int, one: Any, two: Any) -> Any:
    """Return the entries (11, 12, 22) of a symmetric tensor in a tangent basis; its six numbers begin at ``first``."""
    aa, ab, bb = 0.0, 0.0, 0.0
    for entry in range(6):
        i, j = TENSOR_ROWS[entry], TENSOR_COLUMNS[entry]
        value = tensors[first + entry]
        if i == j:
            aa += value * one[i] * one[i]
            ab += value * one[i] * two[i]
            bb += value * two[i] * two[i]
        else:
            aa += 2.0 * value * one[i] * one[j]
            ab += value * (one[i] * two[j] + one[j] * two[i])
            bb += 2.0 * value * two[i] * two[j]
    return aa, ab, bb


def fill_surface_maps(
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
    normal: NDArray[np.float64],
    corners: NDArray[np.int32],
    tensors: NDArray[np.float64],
    to_camera: NDArray[np.float64],
    complete: bool,
) -> tuple[NDArray[np.float64], ...]:
    """Interpolate the tensors of surface points at every pixel and compute principal values and directions.

    ``normal``: Unit face normal in the camera frame, towards the camera, shape (3, n).
    ``corners``: Surface points at the face corners, as indices into ``tensors``, shape (m, 3).
    ``tensors``: Tensors of surface points in the world, see `scenetruth.scene.surface_tensor_kernels.surface_tensors`,
      shape (k, 18); if not ``complete``, only the diagonal of the rate of deformation, shape (k, 3).
    ``to_camera``: Rotation from the world to the camera frame, shape (3, 3).
    Returns: Principal curvatures in 1/mm, the larger first, positive where the surface bulges towards the camera, shape
    (2, n); rotation rate in rad per frame in the camera frame, (3, n); growth rate, 1 per frame, (n,); principal growth
    rates, the larger first, 1 per frame, (2, n); and the direction of the larger rate in the camera frame, with X >= 0,
    (3, n). NaN for rays without a hit; the direction is also NaN for equal principal rates.
    """
    count = face.shape[0]
    size = count if complete else 0
    curvature = np.empty((2, size), dtype=np.float64)
    rotation = np.empty((3, size), dtype=np.float64)
    growth = np.empty(count, dtype=np.float64)
    principal = np.empty((2, size), dtype=np.float64)
    direction = np.empty((3, size), dtype=np.float64)
    out = (curvature, rotation, growth, principal, direction)
    in_bands(
        _fill_surface_maps,
        count,
        face,
        weights,
        normal,
        corners,
        tensors,
        to_camera,
        complete,
        out,
        least=_LEAST_POINTS,
    )
    return out


@kernel()
def _fill_surface_maps(
    low: int, high: int, face: NDArray[np.int32], weights: NDArray[np.float64], normal: NDArray[np.float64],
    corners: NDArray[np.int32], tensors: NDArray[np.float64], to_camera: NDArray[np.float64], complete: bool,
    out: tuple[NDArray[np.float64], ...],
) -> None:  # fmt: skip
    curvature, rotation, growth, principal, direction = out
    mean, middle = np.empty(WIDTH, dtype=np.float64), np.empty(3, dtype=np.float64)
    one, two, way = np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64)
    for n in range(np.uint64(low), np.uint64(high)):
        met = face[n]
        if met < 0:
            growth[n] = np.nan
            if not complete:
                continue
            curvature[0, n] = curvature[1, n] = principal[0, n] = principal[1, n] = np.nan
            for k in range(3):
                rotation[k, n] = direction[k, n] = np.nan
            continue
        b1, b2 = weights[n, 0], weights[n, 1]
        first, second, third = corners[met, 0], corners[met, 1], corners[met, 2]
        begin = 0 if complete else DEFORMATION
        for k in range(WIDTH if complete else 3):
            value = tensors[first, k]
            mean[begin + k] = value + b1 * (tensors[second, k] - value) + b2 * (tensors[third, k] - value)
        growth[n] = mean[DEFORMATION] + mean[DEFORMATION + 1] + mean[DEFORMATION + 2]
        if not complete:
            continue
        length = np.sqrt(mean[NORMAL] ** 2 + mean[NORMAL + 1] ** 2 + mean[NORMAL + 2] ** 2)
        if not length > 0.0:
            length = np.nan
        for k in range(3):
            middle[k] = mean[NORMAL + k] / length
        # Two tangents, from the axis with the largest angle to the normal.
        axis = 0
        for k in range(1, 3):
            if abs(middle[k]) < abs(middle[axis]):
                axis = k
        along = middle[axis]
        square = 1.0 - along * along
        for k in range(3):
            one[k] = ((1.0 if k == axis else 0.0) - along * middle[k]) / np.sqrt(square)
        for k in range(3):
            two[k] = middle[(k + 1) % 3] * one[(k + 2) % 3] - middle[(k + 2) % 3] * one[(k + 1) % 3]
        aa, ab, bb = _tangential(mean, DEFORMATION, one, two)
        half, spread = 0.5 * (aa - bb), np.hypot(0.5 * (aa - bb), ab)
        principal[0, n], principal[1, n] = 0.5 * growth[n] + spread, 0.5 * growth[n] - spread
        # Eigenvector of the larger eigenvalue, from the half angle.
        angle = 0.5 * np.arctan2(ab, half)
        for k in range(3):
            way[k] = np.cos(angle) * one[k] + np.sin(angle) * two[k]
        if spread <= _EQUAL * (abs(aa) + abs(bb)) or spread < 1e-15:
            way[0] = way[1] = way[2] = np.nan
        aa, ab, bb = _tangential(mean, CURVATURE, one, two)
        trace, spread = 0.5 * (aa + bb), np.hypot(0.5 * (aa - bb), ab)
        facing = 0.0
        for k in range(3):
            turned = to_camera[k, 0] * middle[0] + to_camera[k, 1] * middle[1] + to_camera[k, 2] * middle[2]
            facing += turned * normal[k, n]
            rotation[k, n] = (
                to_camera[k, 0] * mean[ROTATION]
                + to_camera[k, 1] * mean[ROTATION + 1]
                + to_camera[k, 2] * mean[ROTATION + 2]
            )
            direction[k, n] = to_camera[k, 0] * way[0] + to_camera[k, 1] * way[1] + to_camera[k, 2] * way[2]
        # Positive where the surface bulges towards the camera.
        sign = -1.0 if facing > 0.0 else 1.0
        large, small = sign * trace + spread, sign * trace - spread
        curvature[0, n], curvature[1, n] = large, small
        if direction[0, n] < 0.0 or (direction[0, n] == 0.0 and direction[1, n] < 0.0):
            for k in range(3):
                direction[k, n] = -direction[k, n]


_LEAST_COLUMNS, _LEAST_ROWS = 64, 16  # minimum number of columns and rows per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


def distances(marked: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the exact distance in px of every pixel centre to the nearest marked pixel (Meijster et al., 2000)."""
    height, width = marked.shape
    along = np.empty((height, width), dtype=np.int64)
    in_bands(_along_columns, width, marked, along, least=_LEAST_COLUMNS)
    out = np.empty((height, width), dtype=np.float64)
    in_bands(_across_rows, height, along, out, least=_LEAST_ROWS)
    return out


@kernel()
def _along_columns(left: int, right: int, marked: NDArray[np.bool_], along: NDArray[np.int64]) -> None:
    """Compute the distance to the nearest marked pixel of the same column, for adjacent columns (contiguous memory)."""
    height, width = marked.shape
    far = height + width
    for x in range(left, right):
        along[0, x] = 0 if marked[0, x] else far
    for y in range(1, height):
        for x in range(left, right):
            along[y, x] = 0 if marked[y, x] else along[y - 1, x] + 1
    for y in range(height - 2, -1, -1):
        for x in range(left, right):
            along[y, x] = min(along[y, x], along[y + 1, x] + 1)


@kernel()
def _across_rows(low: int, high: int, along: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    width = along.shape[1]
    # Lower envelope of the parabolas (x - i)² + along[i]²: their vertices, and the start of each segment.
    place, begin = np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64)
    for y in range(np.uint64(low), np.uint64(high)):
        last = 0
        place[0], begin[0] = 0, 0
        for x in range(1, width):
            own = along[y, x] * along[y, x] + x * x
            while last >= 0:
                i, at = place[last], begin[last]
                if (at - i) ** 2 + along[y, i] ** 2 > (at - x) ** 2 + along[y, x] ** 2:
                    last -= 1
                else:
                    break
            if last < 0:
                last = 0
                place[0], begin[0] = x, 0
                continue
            i = place[last]
            # First column at which the new parabola is lower.
            start = 1 + (own - along[y, i] ** 2 - i * i) // (2 * (x - i))
            if start < width:
                last += 1
                place[last], begin[last] = x, start
        for x in range(width - 1, -1, -1):
            i = place[last]
            out[y, x] = np.sqrt(float((x - i) ** 2 + along[y, i] ** 2))
            if x == begin[last]:
                last -= 1

"""A kernel that writes the maps of curvature, rotation rate and growth from the tensors of surface points."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

# numba keeps compiled kernels until their own file changes: after a change of these places, change this file too.
from scenetruth.scene.surface.columns import (
    CURVATURE,
    DEFORMATION,
    NORMAL,
    ROTATION,
    TENSOR_COLUMNS,
    TENSOR_ROWS,
    WIDTH,
)
from scenetruth.threads import in_bands

__all__ = ["fill_surface_maps"]

# Principal rates that differ by less than this share of the tensor's size have no directions.
_EQUAL = 1e-9
# Pixels that are worth a thread of their own.
_LEAST = 1024
# Kernels count in unsigned numbers: whether a signed index is negative is asked at every element.


@numba.njit(cache=True, nogil=True)
def _tangential(tensors: Any, first: int, one: Any, two: Any) -> Any:
    """Return the entries (11, 12, 22) of a symmetric tensor on two tangents; its six numbers begin at ``first``."""
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
    """Interpolate the tensors of surface points at every pixel, and find their principal values and directions.

    Parameters
    ----------
    face, weights
        The face that each pixel sees, -1 for none, and barycentric coordinates on it, as of `Hits`.
    normal
        Unit normal of this face in the camera's frame, towards the camera, shape (3, n).
    corners
        The surface points at the corners of the faces, as indices into ``tensors``, shape (m, 3).
    tensors
        Tensors of surface points in the world, as of `scenetruth.scene.surface.kernels.surface_tensors`, shape (k, 18).
    to_camera
        Rotation from the world to the camera's frame, shape (3, 3).
    complete
        Whether all is wanted, or only the growth of the area; then the others have no pixels, n = 0.

    Returns
    -------
    tuple of numpy.ndarray
        Principal curvatures in 1/mm, the larger first, positive where the surface bulges towards the camera, shape
        (2, n); rotation rate in rad per frame in the camera's frame, (3, n); rate of growth of the area, 1 per frame,
        (n,); principal rates of growth, the larger first, 1 per frame, (2, n); and the direction of the first of them
        in the camera's frame, with X >= 0, (3, n). NaN where nothing is met. The direction is also NaN where both
        principal rates are the same.
    """
    count = face.shape[0]
    size = count if complete else 0
    curvature = np.empty((2, size), dtype=np.float64)
    rotation = np.empty((3, size), dtype=np.float64)
    growth = np.empty(count, dtype=np.float64)
    principal = np.empty((2, size), dtype=np.float64)
    direction = np.empty((3, size), dtype=np.float64)
    out = (curvature, rotation, growth, principal, direction)
    in_bands(_fill_surface_maps, count, face, weights, normal, corners, tensors, to_camera, complete, out, least=_LEAST)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill_surface_maps(
    low: int, high: int, face: NDArray[np.int32], weights: NDArray[np.float64], normal: NDArray[np.float64],
    corners: NDArray[np.int32], tensors: NDArray[np.float64], to_camera: NDArray[np.float64], complete: bool,
    out: tuple[NDArray[np.float64], ...],
) -> None:  # fmt: skip
    curvature, rotation, growth, principal, direction = out
    mean, middle = np.empty(WIDTH), np.empty(3)
    one, two, way = np.empty(3), np.empty(3), np.empty(3)
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
        for k in range(0 if complete else DEFORMATION, WIDTH if complete else DEFORMATION + 3):
            value = tensors[first, k]
            mean[k] = value + b1 * (tensors[second, k] - value) + b2 * (tensors[third, k] - value)
        growth[n] = mean[DEFORMATION] + mean[DEFORMATION + 1] + mean[DEFORMATION + 2]
        if not complete:
            continue
        length = np.sqrt(mean[NORMAL] ** 2 + mean[NORMAL + 1] ** 2 + mean[NORMAL + 2] ** 2)
        if not length > 0.0:
            length = np.nan
        for k in range(3):
            middle[k] = mean[NORMAL + k] / length
        # Two tangents, from the axis that is farthest from the normal.
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
        # The eigenvector of the larger value, from the half angle.
        angle = 0.5 * np.arctan2(ab, half)
        for k in range(3):
            way[k] = np.cos(angle) * one[k] + np.sin(angle) * two[k]
        if spread <= _EQUAL * (abs(aa) + abs(bb)) or spread < 1e-15:
            way[:] = np.nan
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

"""A kernel that writes the maps of a truth from what the rays of the pixels meet."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.threads import in_bands

__all__ = ["MovingMesh", "fill_maps"]

# Pixels that are worth a thread of their own.
_LEAST = 4096
# Kernels count in unsigned numbers: whether a signed index is negative is asked at every element.


class MovingMesh(NamedTuple):
    """A mesh and how it moves; vectors in the camera's frame."""

    faces: NDArray[np.int32]
    """Corners of the faces, shape (m, 3)."""
    velocities: NDArray[np.float64]
    """Velocities of the vertices in mm per frame, shape (n, 3)."""
    normals: NDArray[np.float64]
    """Unit normals of the faces, shape (m, 3)."""
    face_body: NDArray[np.int32]
    """The body that each face belongs to, shape (m,)."""
    face_offsets: NDArray[np.int64]
    """The first face of each body."""


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
    """Write velocity, rates, disparity, normal, object and face of every pixel.

    Parameters
    ----------
    face, depth, weights
        What the pixels' rays meet, as of `Hits`.
    directions
        The rays' directions in the camera's frame, with Z = 1, shape (k, 3).
    mesh
        What they meet.
    scale
        Multiplies the rates of X / Z and Y / Z: the focal length in px, or 1.
    disparity_depth
        Product of disparity and depth, f V_X, in px mm.

    Returns
    -------
    tuple of numpy.ndarray
        Velocity, shape (3, k); rates, (2, k); disparity, (k,); normal, (3, k), towards the camera; object and face
        within the object, (k,). NaN and -1 where nothing is met.
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
        # first + b1 (second - first) + ...: a velocity that all corners share comes out unchanged.
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

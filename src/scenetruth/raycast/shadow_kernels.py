"""Kernels that decide in float64 whether a face lies between a light and a point."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.threads import in_bands

__all__ = ["confirm_blocked", "meets"]


@numba.njit(cache=True, nogil=True)
def meets(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, start: NDArray[np.float64],
    way: NDArray[np.float64], farthest: float,
) -> Any:  # fmt: skip
    """Tell whether a ray meets a face between its start and the share ``farthest`` of its length.

    The test is that of Möller and Trumbore (J. Graphics Tools 2, 1997).

    Parameters
    ----------
    vertices, faces, farthest
        As of `confirm_blocked`.
    face
        Index of the face.
    start, way
        Start and vector of the ray in mm, shape (3,).
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
    """Tell which rays from a light are blocked before they reach their point.

    The face that Embree guessed and its three neighbours are tested in float64, but never the point's own face.

    Parameters
    ----------
    vertices
        World positions in mm, shape (n, 3).
    faces
        Corners of the faces, shape (m, 3).
    neighbours
        The face across each edge, shape (m, 3), -1 for none (`Topology.face_neighbours`).
    starts
        Where the rays start, in mm, shape (k, 3).
    ways
        Vectors from there to the points, in mm, shape (k, 3).
    guesses
        The face that Embree found for each ray, -1 for none, shape (k,).
    own
        The face on which each point lies, shape (k,).
    farthest
        Share of the ray's length, below 1, beyond which faces do not block it.

    Returns
    -------
    numpy.ndarray
        bool, shape (k,).
    """
    count = starts.shape[0]
    out = np.empty(count, dtype=np.bool_)
    in_bands(_confirm_blocked, count, vertices, faces, neighbours, starts, ways, guesses, own, farthest, out)
    return out


@numba.njit(cache=True, nogil=True)
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

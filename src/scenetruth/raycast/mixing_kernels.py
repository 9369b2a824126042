"""Kernels that interpolate values on the faces that rays meet."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.threads import in_bands

__all__ = ["mix_vertices"]

# Rays, of some ns each, that are worth a thread of their own.
_LEAST = 4096


@numba.njit(cache=True, nogil=True, inline="always")
def _mixed(first: float, second: float, third: float, b1: float, b2: float) -> float:
    """Interpolate: a value that all corners share comes out unchanged."""
    return first + b1 * (second - first) + b2 * (third - first)


def mix_vertices(
    face: NDArray[np.int32], weights: NDArray[np.float64], faces: NDArray[np.int32], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate values that are given at vertices.

    Parameters
    ----------
    face
        Index of the face, -1 for none, shape (n,).
    weights
        Barycentric coordinates of its second and third corner, shape (n, 2).
    faces
        Corners of the faces, shape (m, 3).
    values
        Shape (vertices, k).

    Returns
    -------
    numpy.ndarray
        Shape (n, k); NaN where there is no face.
    """
    out = np.empty((face.shape[0], values.shape[1]), dtype=np.float64)
    in_bands(_mix_vertices, face.shape[0], face, weights, faces, values, out, least=_LEAST)
    return out


@numba.njit(cache=True, nogil=True)
def _mix_vertices(
    low: int, high: int, face: NDArray[np.int32], weights: NDArray[np.float64], faces: NDArray[np.int32],
    values: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    size = values.shape[1]
    for n in range(low, high):
        met, b1, b2 = face[n], weights[n, 0], weights[n, 1]
        for k in range(size):
            if met < 0:
                out[n, k] = np.nan
            else:
                first, second, third = faces[met, 0], faces[met, 1], faces[met, 2]
                out[n, k] = _mixed(values[first, k], values[second, k], values[third, k], b1, b2)

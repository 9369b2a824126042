"""Kernels that interpolate values on the faces that rays meet."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["mix_vertices"]


@numba.njit(cache=True, nogil=True, inline="always")
def _mixed(first: float, second: float, third: float, b1: float, b2: float) -> float:
    """Interpolate: a value that all corners share comes out unchanged."""
    return first + b1 * (second - first) + b2 * (third - first)


@numba.njit(cache=True, nogil=True, parallel=True)
def mix_vertices(
    face: NDArray[np.int32], weights: NDArray[np.float64], faces: NDArray[np.int32], values: NDArray[np.float64]
) -> Any:
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
    count, size = face.shape[0], values.shape[1]
    out = np.empty((count, size), dtype=np.float64)
    for n in numba.prange(count):
        met, b1, b2 = face[n], weights[n, 0], weights[n, 1]
        for k in range(size):
            if met < 0:
                out[n, k] = np.nan
            else:
                first, second, third = faces[met, 0], faces[met, 1], faces[met, 2]
                out[n, k] = _mixed(values[first, k], values[second, k], values[third, k], b1, b2)
    return out

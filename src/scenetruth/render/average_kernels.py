"""Kernels that average the samples of pixels."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["average_samples"]


@numba.njit(cache=True, nogil=True, parallel=True)
def average_samples(samples: NDArray[np.float32], weights: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """Write the weighted means of n x n samples, whose rows run from the bottom up, to an image from the top down.

    ``samples`` has the shape (height n, width n), ``out`` (height, width); ``weights``, shape (n,), serve both axes and
    sum to 1. Sums are float64.
    """
    height, width = out.shape
    n = weights.shape[0]
    for y in numba.prange(height):
        sums = np.zeros(width)
        for k in range(n):
            row = samples[(height - y) * n - 1 - k]
            for x in range(width):
                total = 0.0
                for j in range(n):
                    total += weights[j] * row[x * n + j]
                sums[x] += weights[k] * total
        for x in range(width):
            out[y, x] = sums[x]

"""Kernel that averages the samples of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["average_samples"]

_LEAST_ROWS = 8  # minimum number of pixel rows per thread


def average_samples(samples: NDArray[np.float32], weights: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """Average n x n samples per pixel in float64, with weights of sum 1 per axis, and flip the image vertically."""
    in_bands(_average_samples, out.shape[0], samples, weights, out, least=_LEAST_ROWS)


@kernel()
def _average_samples(
    low: int, high: int, samples: NDArray[np.float32], weights: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    height, width = out.shape
    n = weights.shape[0]
    sums = np.empty(width)
    for y in range(low, high):
        sums[:] = 0.0
        for k in range(n):
            row = samples[(height - y) * n - 1 - k]
            for x in range(width):
                total = 0.0
                for j in range(n):
                    total += weights[j] * row[x * n + j]
                sums[x] += weights[k] * total
        for x in range(width):
            out[y, x] = sums[x]

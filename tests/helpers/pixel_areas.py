"""Exact areas in pixels that tests compare with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def area_beyond(normal: NDArray[np.float64], distance: float) -> float:
    """Return the area of the unit square around 0 where normal . p > distance, by clipping it."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    height, kept = square @ normal - distance, []
    for k in range(4):
        one, two = height[k - 1], height[k]
        if (one > 0) != (two > 0):
            kept.append(square[k - 1] + one / (one - two) * (square[k] - square[k - 1]))
        if two > 0:
            kept.append(square[k])
    x, y = np.array(kept).reshape(-1, 2).T
    return float(abs(np.sum(np.roll(x, 1) * y - np.roll(y, 1) * x)) / 2)

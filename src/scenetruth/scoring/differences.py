"""Differences and lengths of maps that may hold anything, up to the largest floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["difference", "diverged", "length"]

Map = NDArray[np.float64]

diverged = np.errstate(over="ignore", invalid="ignore")
"""Context and decorator for estimates that diverge up to the largest floats; what overflows becomes None later."""


@diverged
def difference(estimate: Map, truth: Map) -> Map:
    """Return estimate - truth in float64, whatever the types of both."""
    return np.asarray(np.subtract(estimate, truth, dtype=np.float64))


@diverged
def length(vectors: Map) -> Map:
    """Return the Euclidean lengths of vectors, shape (component, ...)."""
    found: Map = np.hypot.reduce(vectors, axis=0)
    return found

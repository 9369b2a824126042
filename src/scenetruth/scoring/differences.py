"""Differences and lengths of maps that may hold anything, up to the largest floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["angle_deg", "difference", "diverged", "length"]

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


@diverged
def angle_deg(one: Map, other: Map, *, lines: bool = False) -> Map:
    """Return the angles in degrees between vectors of three components, shape (3, ...), or between lines along them.

    Examples
    --------
    >>> angle_deg(np.array([1.0, 1.0, 0.0]), np.array([-2.0, 0.0, 0.0])).round(6)
    np.float64(135.0)
    >>> angle_deg(np.array([1.0, 1.0, 0.0]), np.array([-2.0, 0.0, 0.0]), lines=True).round(6)
    np.float64(45.0)
    """
    along = np.einsum("k...,k...->...", one, other, dtype=np.float64)
    # Right for the smallest angles too, of which the cosine is 1.
    across = length(np.cross(one, other, axis=0))
    found: Map = np.degrees(np.arctan2(across, np.abs(along) if lines else along))
    return found

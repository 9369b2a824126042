"""Robust sums of errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fitted_factor", "lengths", "weighted_median"]

Map = NDArray[np.float64]


def weighted_median(values: Map, weights: Map) -> float:
    """Return the value that half of the weight lies below; NaN without any weight.

    Parameters
    ----------
    values, weights
        Shape (n,); weights are not negative.

    Examples
    --------
    >>> weighted_median(np.array([5.0, 1.0, 2.0]), np.array([1.0, 1.0, 3.0]))
    2.0
    """
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    if not (below.size and below[-1] > 0):
        return float("nan")
    return float(values[order[np.searchsorted(below, 0.5 * below[-1])]])


def lengths(vectors: Map) -> Map:
    """Return the lengths of vectors, shape (component, n)."""
    if len(vectors) == 1:
        return np.asarray(np.abs(vectors[0]))
    return np.asarray(np.sqrt(np.einsum("cn,cn->n", vectors, vectors)))


def fitted_factor(found: Map, expected: Map) -> float:
    """Return the factor a for which the sum of abs(found - a expected) is least; NaN where nothing is expected.

    Parameters
    ----------
    found, expected
        Shape (component, n).
    """
    there = expected != 0
    expected = expected[there]
    return weighted_median(found[there] / expected, np.abs(expected))

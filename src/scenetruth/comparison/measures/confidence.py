"""What a method's own confidence is worth: errors of what it is surest of, and how many errors lie within its bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["KEPT", "WITHIN", "calibration", "reliability", "sparsification"]

KEPT: Sequence[float] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Shares of the pixels that are kept, the surest first."""
WITHIN: Sequence[float] = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Numbers of standard deviations at which errors are counted."""

Map = NDArray[np.float64]


def sparsification(errors: Map, std: Map, kept: Sequence[float] = KEPT) -> list[float]:
    """Return the root of the mean square error of the surest pixels, for each share that is kept.

    Parameters
    ----------
    errors, std
        Errors and stated standard deviations of the pixels, shape (n,).
    kept
        Shares, above 0 and at most 1.

    Examples
    --------
    >>> sparsification(np.array([1.0, 3.0]), np.array([0.1, 0.2]), [0.5, 1.0])
    [1.0, 2.23606797749979]
    """
    squares = np.square(errors[np.argsort(std, kind="stable")])
    means = np.cumsum(squares) / np.arange(1, len(squares) + 1)
    places = np.maximum(np.ceil(np.asarray(kept) * len(squares)).astype(int), 1) - 1
    return [float(value) for value in np.sqrt(means[places])]


def reliability(errors: Map, std: Map, within: Sequence[float] = WITHIN) -> list[float]:
    """Return the share of errors within so many stated standard deviations, for each number of them."""
    scaled = np.abs(errors) / std
    return [float(np.mean(scaled <= number)) for number in within]


def calibration(errors: Map, std: Map) -> float:
    """Return the root of the mean square of error over stated standard deviation: 1 is honest, above is too sure."""
    return float(np.sqrt(np.mean(np.square(errors / std))))

"""Quadrature rules for the mean over a pixel's footprint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["even_rule", "gauss_rule"]

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]


def even_rule(count: int) -> Rule:
    """Return evenly spaced samples along one axis of a footprint, with weights for the highest order.

    Equal weights (the midpoint rule) are exact for linear functions only, and amplify a wave of f cycles per pixel by
    1 + (πf / n)² / 6. From three samples on, there are weights that are exact for cubic functions; those nearest to
    equal are taken: 1/n + a (x² - mean of x²).

    Parameters
    ----------
    count
        Number of samples n.

    Returns
    -------
    tuple of numpy.ndarray
        Positions in [-1/2, 1/2] px and weights that sum to 1, shape (n,), float64.
    """
    positions = (np.arange(count) + 0.5) / count - 0.5
    weights = np.full(count, 1 / count)
    if count > 2:
        squares = positions**2 - np.mean(positions**2)
        # The second moment of a unit interval is 1/12; equal weights give (1 - 1/n²) / 12.
        weights += squares * (1 / 12 - np.mean(positions**2)) / np.sum(squares**2)
    return positions, weights


def gauss_rule(count: int) -> Rule:
    """Return Gauss and Legendre's samples along one axis of a footprint, exact for polynomials of degree 2n - 1.

    Parameters
    ----------
    count
        Number of samples n.

    Returns
    -------
    tuple of numpy.ndarray
        Positions in [-1/2, 1/2] px and weights that sum to 1, shape (n,), float64.
    """
    positions, weights = np.polynomial.legendre.leggauss(count)
    return positions / 2, weights / 2

"""Kernel for the variances of derivatives in incomplete windows by correlated errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["sum_over_modes"]

Map = NDArray[np.float64]

_LEAST = 32  # minimum number of windows per thread


def sum_over_modes(
    projected: Map,
    rows: Map,
    eigenvalues: Map,
    counts: NDArray[np.int64],
    centres: NDArray[np.int64],
    polynomials: Map,
    offsets: Map,
) -> Map:
    """Compute Σ λ (Σ φ_k(y) φ_l(x) weight(y, x) p_i(y, x) s(y, x)) (... p_j ...) over modes, for every window.

    ``projected``: Σ φ_l(x) weight(x) u(x)^a s(y, x) over the columns of windows around every x, shape (x, l, a, y),
      with the reach of a window before and after all y.
    ``rows``: φ_k(y) weight(y), shape (point, k).
    ``eigenvalues``: λ of modes k and l, shape (k, l). ``counts``: Number of modes k that are summed for every l.
    ``centres``: Row and column of every window, shape (n, 2).
    ``polynomials``: Coefficients of u(x)^a v(y)^b in p_i, shape (n, a, b, i), i from 0 to 1.
    ``offsets``: v of every point, shape (point,).
    Returns: The sums, shape (2, 2, n).
    """
    found = np.empty((len(centres), 3))
    # Windows of one column use the same part of ``projected``.
    order = np.lexsort((centres[:, 0], centres[:, 1]))
    in_bands(
        _sum_over_modes, len(centres), projected, rows, eigenvalues, counts, centres, polynomials, offsets, order,
        found, least=_LEAST,
    )  # fmt: skip
    return np.stack([found[:, [0, 1]], found[:, [1, 2]]]).transpose(0, 2, 1)


@kernel(fastmath={"contract", "reassoc", "nsz", "arcp"})
def _sum_over_modes(
    first: int, last: int, projected: Map, rows: Map, eigenvalues: Map, counts: NDArray[np.int64],
    centres: NDArray[np.int64], polynomials: Map, offsets: Map, order: NDArray[np.int64], found: Map,
) -> Any:  # fmt: skip
    points, modes = rows.shape
    _, across, powers, _ = projected.shape
    factors = np.empty((powers, points, 2))
    sums, other_sums = np.empty(modes), np.empty(modes)
    for place in range(first, last):
        n = order[place]
        top, column = centres[n, 0], centres[n, 1]
        for a in range(powers):
            for y in range(points):
                one, other, power = 0.0, 0.0, 1.0
                for b in range(powers - a):
                    one += polynomials[n, a, b, 0] * power
                    other += polynomials[n, a, b, 1] * power
                    power *= offsets[y]
                factors[a, y, 0], factors[a, y, 1] = one, other
        own, both, others = 0.0, 0.0, 0.0
        for mode in range(across):
            count = counts[mode]
            sums[:count] = 0.0
            other_sums[:count] = 0.0
            for y in range(points):
                one, other = 0.0, 0.0
                for a in range(powers):
                    value = projected[column, mode, a, top + y]
                    one += factors[a, y, 0] * value
                    other += factors[a, y, 1] * value
                for k in range(count):
                    sums[k] += rows[y, k] * one
                    other_sums[k] += rows[y, k] * other
            for k in range(count):
                weight = eigenvalues[k, mode]
                own += weight * sums[k] * sums[k]
                both += weight * sums[k] * other_sums[k]
                others += weight * other_sums[k] * other_sums[k]
        found[n, 0], found[n, 1], found[n, 2] = own, both, others

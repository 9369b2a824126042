"""Variances in many windows at once, from sums over them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.model import Columns, Model, Vector
from scenetruth.bound.products import pair_of

__all__ = ["normal_matrix", "variances_of"]

Map = NDArray[np.float64]

# Of a matrix with ones on its diagonal: less is lost in rounding, or in what noise leaves of its own products.
_LEAST_PIVOT = 1e-9


def normal_matrix(sums: dict[tuple[int, int, int], Map], columns: Columns, model: Model) -> Map:
    """Return the information on what is unknown, Cᵀ F C with that on all parameters F.

    Parameters
    ----------
    sums
        Sums over windows, as of `Part`.
    columns
        What is unknown, the columns of C.
    model
        The parameters.

    Returns
    -------
    numpy.ndarray
        Shape (unknowns, unknowns, windows).
    """
    pairs = pair_of(model.fields)

    def full(p: int, q: int) -> Map:
        one, other = sorted((model.field_of(p), model.field_of(q)))
        (x, y), (more_x, more_y) = model.powers_of(p), model.powers_of(q)
        return sums[pairs[one, other], x + more_x, y + more_y]

    count = len(columns)
    windows = len(next(iter(sums.values())))
    found = np.empty((count, count, windows))
    for j, column in enumerate(columns):
        times: dict[int, Map] = {}
        for i in range(j + 1):
            total = np.zeros(windows)
            for p, share in columns[i]:
                if p not in times:
                    times[p] = sum((part * full(p, q) for q, part in column), np.zeros(windows))
                total += share * times[p]
            found[i, j] = found[j, i] = total
    return found


def variances_of(normal: Map, scatter: Map, columns: Columns, functionals: Sequence[Vector]) -> Map:
    """Return the variances of linear functions of what is unknown, whose covariance is H⁻¹ S H⁻¹.

    Parameters
    ----------
    normal, scatter
        H and S, as of `normal_matrix`.
    columns
        What is unknown.
    functionals
        Linear functions of the parameters.

    Returns
    -------
    numpy.ndarray
        Shape (functionals, windows); NaN where H is singular, so that the images do not tell all that is unknown.
    """
    count, windows = normal.shape[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.einsum("iin->in", normal))
        factor = _factorised(normal * scale[:, None] * scale)
        rights = np.zeros((len(functionals), count, windows))
        for k, functional in enumerate(functionals):
            parts = dict(functional)
            for i, column in enumerate(columns):
                for p, share in column:
                    if p in parts:
                        rights[k, i] += share * parts[p]
        solved = _solved(factor, rights * scale) * scale
        total = np.zeros((len(functionals), windows))
        for i in range(count):
            for j in range(count):
                total += solved[:, i] * scatter[i, j] * solved[:, j]
        # What noise leaves of its own products may be negative where there is hardly any texture.
        return np.where(total > 0, total, np.nan)


def _factorised(matrix: Map) -> Map:
    """Return L with L Lᵀ the matrix, shape (n, n, windows); NaN where it is not positive definite."""
    count = len(matrix)
    factor = np.zeros_like(matrix)
    for j in range(count):
        left = matrix[j:, j].copy()
        for k in range(j):
            left -= factor[j:, k] * factor[j, k]
        pivot = np.sqrt(np.where(left[0] > _LEAST_PIVOT, left[0], np.nan))
        factor[j:, j] = left / pivot
    return factor


def _solved(factor: Map, rights: Map) -> Map:
    """Solve L Lᵀ v = r for several r, shape (several, n, windows)."""
    found = rights.copy()
    count = len(factor)
    for i in range(count):
        for k in range(i):
            found[:, i] -= factor[i, k] * found[:, k]
        found[:, i] /= factor[i, i]
    for i in reversed(range(count)):
        for k in range(i + 1, count):
            found[:, i] -= factor[k, i] * found[:, k]
        found[:, i] /= factor[i, i]
    return found

"""Functions with a removable gap at zero, as fields with all derivatives: (exp(x) - 1) / x and sin(√q) / √q."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.jets.jet import Field, compose, values_of

__all__ = ["exp_quotient", "sinc_root"]

Floats = NDArray[np.floating[Any]]

# Below these arguments series, above them formulas. The last terms kept are below half an ulp of 80-bit floats:
# 0.5^18 / 19! = 3e-23 and 1 / 29! = 1e-31; the second derivatives are n^2 = 400 times as large.
_LARGEST_SERIES_EXP, _EXP_TERMS = 0.5, 20
_LARGEST_SERIES_SINC, _SINC_TERMS = 1.0, 14


def _with_derivatives(coefficients: list[np.longdouble]) -> tuple[list[np.longdouble], ...]:
    first = [n * c for n, c in enumerate(coefficients)][1:]
    return coefficients, first, [n * c for n, c in enumerate(first)][1:]


_EXP = _with_derivatives([1 / np.longdouble(factorial(n + 1)) for n in range(_EXP_TERMS)])
_SINC = _with_derivatives([(-1) ** n / np.longdouble(factorial(2 * n + 1)) for n in range(_SINC_TERMS)])


def exp_quotient(x: Field) -> Any:
    """Return φ(x) = (exp(x) - 1) / x, and 1 at zero."""
    values = np.asarray(values_of(x))
    small = np.abs(values) < _LARGEST_SERIES_EXP
    if small.all():
        return compose(x, *(_polynomial(row, values) for row in _EXP))
    far = np.where(small, 1, values)
    power = np.exp(far)
    value = np.expm1(far) / far
    first = (power - value) / far
    return compose(x, *_joined(small, values, _EXP, (value, first, (power - 2 * first) / far)))


def sinc_root(q: Field) -> Any:
    """Return sin(√q) / √q for q >= 0, and 1 at zero; sin(x) / x is its value at x²."""
    values = np.asarray(values_of(q))
    small = values < _LARGEST_SERIES_SINC
    if small.all():
        return compose(q, *(_polynomial(row, values) for row in _SINC))
    far = np.where(small, 1, values)
    root = np.sqrt(far)
    value = np.sin(root) / root
    first = (np.cos(root) - value) / (2 * far)
    return compose(q, *_joined(small, values, _SINC, (value, first, -(value / 2 + 3 * first) / (2 * far))))


def _joined(
    small: NDArray[np.bool_], x: Floats, rows: tuple[list[np.longdouble], ...], far: tuple[Floats, ...]
) -> list[Floats]:
    near = np.where(small, x, 0)
    return [np.where(small, _polynomial(row, near), formula) for row, formula in zip(rows, far, strict=True)]


def _polynomial(coefficients: list[np.longdouble], x: Floats) -> Floats:
    """Evaluate a polynomial by Horner's rule in the precision of x."""
    # Terms that 53 bits cannot hold are left out: 0.5^14 / 15! = 5e-17, with n^2 = 200 for the second derivative.
    kept = coefficients if x.dtype == np.longdouble else coefficients[:16]
    numbers = [x.dtype.type(c) for c in kept]
    result = np.full_like(x, numbers[-1])
    for number in numbers[-2::-1]:
        result *= x
        result += number
    return result

"""Second-order Taylor arithmetic (forward-mode differentiation) in time and along a surface."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AA",
    "AB",
    "ACROSS",
    "ALONG",
    "BB",
    "TA",
    "TB",
    "TT",
    "VALUE",
    "A",
    "B",
    "Jet",
    "JetField",
    "T",
    "compose",
    "exp_quotient",
    "rotate_jets",
    "sinc_root",
    "strip_derivatives",
    "where",
]


Floats = NDArray[np.floating[Any]]

_Parts = tuple[Floats, Floats, Floats]


class Jet(np.lib.mixins.NDArrayOperatorsMixin):
    """Field of n values with all derivatives up to second order in k variables.

    NumPy arithmetic and smooth elementary functions apply to jets (truncated Taylor series, exact to rounding), so a
    formula written for arrays also computes derivatives. Comparisons use the values.

    ``coefficients``: Value, k first derivatives and k (k + 1) / 2 second derivatives (11, 12, ..., 22, ...), shape (1 +
      k + k (k + 1) / 2, n); n = 1 represents a constant field.
    """

    __slots__ = ("coefficients", "variables")

    def __init__(self, coefficients: Floats) -> None:
        self.coefficients = coefficients
        self.variables = {3: 1, 6: 2, 10: 3}[len(coefficients)]

    @classmethod
    def constant(cls, values: Floats, variables: int) -> Jet:
        """Return a field independent of k variables."""
        values = np.atleast_1d(values)
        coefficients = np.zeros((1 + variables + variables * (variables + 1) // 2, len(values)), dtype=values.dtype)
        coefficients[0] = values
        return cls(coefficients)

    @classmethod
    def variable(cls, values: Floats, index: int, variables: int) -> Jet:
        """Return the field of variable ``index`` of k."""
        jet = cls.constant(values, variables)
        jet.coefficients[1 + index] = 1
        return jet

    @property
    def value(self) -> Floats:
        """Values, shape (n,)."""
        values: Floats = self.coefficients[0]
        return values

    def first(self, i: int) -> Floats:
        """Return the derivative with respect to variable i, shape (n,)."""
        values: Floats = self.coefficients[1 + i]
        return values

    def second(self, i: int, j: int) -> Floats:
        """Return the second derivative with respect to variables i and j, shape (n,)."""
        low, high = min(i, j), max(i, j)
        k = self.variables
        values: Floats = self.coefficients[1 + k + low * k - low * (low - 1) // 2 + high - low]
        return values

    def __len__(self) -> int:
        return int(self.coefficients.shape[1])

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or kwargs:
            return NotImplemented
        if ufunc in _COMPARISONS:
            return ufunc(*(strip_derivatives(item) for item in inputs))
        if ufunc in _UNARY:
            return compose(inputs[0], *_UNARY[ufunc](inputs[0].value))
        if ufunc in _BINARY:
            return _BINARY[ufunc](*inputs)
        return NotImplemented

    def __repr__(self) -> str:
        return f"Jet(n={len(self)}, variables={self.variables})"


JetField = NDArray[np.floating[Any]] | Jet
"""Field of values: an array of shape (n,), or a jet."""


def strip_derivatives(field: Any) -> Any:
    """Return the values of a field without derivatives."""
    return field.value if isinstance(field, Jet) else field


def compose(field: JetField, value: Floats, first: Floats, second: Floats) -> Any:
    """Apply a function, given by its value and two derivatives at the field values, shape (n,), to a field."""
    if not isinstance(field, Jet):
        return value
    return Jet(_kernels(field).compose(field.coefficients, *np.broadcast_arrays(value, first, second)))


def where(condition: NDArray[np.bool_], one: Any, other: Any) -> Any:
    """Select values and derivatives by a condition, shape (n,); the fields should join smoothly at its border."""
    jets = [item for item in (one, other) if isinstance(item, Jet)]
    if not jets:
        return np.where(condition, one, other)
    k, dtype = jets[0].variables, jets[0].coefficients.dtype
    parts = [item if isinstance(item, Jet) else Jet.constant(np.asarray(item, dtype=dtype), k) for item in (one, other)]
    return Jet(np.where(condition, parts[0].coefficients, parts[1].coefficients))


def rotate_jets(
    points: tuple[Any, Any, Any], axis: NDArray[np.float64], angle: Any, centre: tuple[float, float, float]
) -> tuple[Jet, Jet, Jet] | None:
    """Return jets rotated by a constant angle, the same numbers in an eighth of the time; None for other fields."""
    if isinstance(angle, Jet) or not all(isinstance(field, Jet) for field in points):
        return None
    x, y, z = (np.ascontiguousarray(field.coefficients) for field in points)
    if x.dtype != np.float64 or not x.shape == y.shape == z.shape:
        return None
    from scenetruth.scene.taylor_kernels import rotate

    around, at = (
        (float(axis[0]), float(axis[1]), float(axis[2])),
        (float(centre[0]), float(centre[1]), float(centre[2])),
    )
    turned = rotate((x, y, z), around, float(np.sin(angle)), float(np.cos(angle)), at)
    return Jet(turned[0]), Jet(turned[1]), Jet(turned[2])


def _kernels(field: Jet) -> Any:
    """Return compiled kernels for float64, or NumPy implementations for other precisions."""
    if field.coefficients.dtype == np.float64:
        from scenetruth.scene import taylor_kernels

        return taylor_kernels
    return _Plain


class _Plain:
    """NumPy implementation for any precision."""

    @staticmethod
    def multiply(x: Floats, y: Floats) -> Floats:
        k = {3: 1, 6: 2, 10: 3}[len(x)]
        i, j = np.triu_indices(k)
        g, h = x[1 : 1 + k], y[1 : 1 + k]
        rows = [x[:1] * y[:1], x[:1] * h + y[:1] * g]
        rows.append(x[:1] * y[1 + k :] + y[:1] * x[1 + k :] + g[i] * h[j] + g[j] * h[i])
        return np.concatenate(rows)

    @staticmethod
    def compose(x: Floats, value: Floats, first: Floats, second: Floats) -> Floats:
        k = {3: 1, 6: 2, 10: 3}[len(x)]
        i, j = np.triu_indices(k)
        g = x[1 : 1 + k]
        return np.concatenate([value[None], first * g, first * x[1 + k :] + second * (g[i] * g[j])])


def _add(one: Any, other: Any) -> Jet:
    return _shifted(one, other, 1)


def _subtract(one: Any, other: Any) -> Jet:
    return _shifted(one, other, -1)


def _shifted(one: Any, other: Any, sign: Literal[-1, 1]) -> Jet:
    if isinstance(one, Jet) and isinstance(other, Jet):
        both = one.coefficients + other.coefficients if sign > 0 else one.coefficients - other.coefficients
        return Jet(both)
    jet, number = (one, other) if isinstance(one, Jet) else (other, one)
    coefficients = jet.coefficients if jet is one or sign > 0 else -jet.coefficients
    length = max(coefficients.shape[1], np.size(number))
    result = np.array(np.broadcast_to(coefficients, (len(coefficients), length)))
    result[0] += number if jet is other or sign > 0 else -np.asarray(number)
    return Jet(result)


def _multiply(one: Any, other: Any) -> Jet:
    if isinstance(one, Jet) and isinstance(other, Jet):
        return Jet(_kernels(one).multiply(one.coefficients, other.coefficients))
    jet, number = (one, other) if isinstance(one, Jet) else (other, one)
    return Jet(jet.coefficients * number)


def _divide(one: Any, other: Any) -> Jet:
    if not isinstance(other, Jet):
        return Jet(one.coefficients / other)
    return _multiply(one, np.reciprocal(other))


def _power(base: Any, exponent: Any) -> Jet:
    if isinstance(exponent, Jet):
        msg = "the exponent of a jet must be a number"
        raise TypeError(msg)
    x, p = base.value, exponent
    if p == 0:
        return Jet.constant(np.ones_like(x), base.variables)
    if p == 1:
        return Jet(base.coefficients.copy())
    steep = p * (p - 1) * np.ones_like(x) if p == 2 else p * (p - 1) * x ** (p - 2)
    result: Jet = compose(base, x**p, p * x ** (p - 1), steep)
    return result


def _arctan2(y: Any, x: Any) -> Any:
    # Derivatives of arctan(y / x) or of -arctan(x / y), whichever is farther from its pole.
    values_y, values_x = np.broadcast_arrays(strip_derivatives(y), strip_derivatives(x))
    flat = np.abs(values_x) > np.abs(values_y)
    numerator, denominator = where(flat, y, -1 * x), where(flat, x, y)
    result = np.arctan(_divide(numerator, denominator))
    result.coefficients[0] = np.arctan2(values_y, values_x)
    return result


def _sqrt(x: Floats) -> _Parts:
    root = np.sqrt(x)
    return root, 0.5 / root, -0.25 / (root * x)


def _tanh(x: Floats) -> _Parts:
    y = np.tanh(x)
    slope = 1 - y * y
    return y, slope, -2 * y * slope


def _tan(x: Floats) -> _Parts:
    y = np.tan(x)
    slope = 1 + y * y
    return y, slope, 2 * y * slope


def _arctan(x: Floats) -> _Parts:
    slope = 1 / (1 + x * x)
    return np.arctan(x), slope, -2 * x * slope * slope


def _exp(x: Floats) -> _Parts:
    y = np.exp(x)
    return y, y, y


def _expm1(x: Floats) -> _Parts:
    y = np.exp(x)
    return np.expm1(x), y, y


def _sin(x: Floats) -> _Parts:
    sine = np.sin(x)
    return sine, np.cos(x), -sine


def _cos(x: Floats) -> _Parts:
    cosine = np.cos(x)
    return cosine, -np.sin(x), -cosine


def _log(x: Floats) -> _Parts:
    inverse = 1 / x
    return np.log(x), inverse, -inverse * inverse


def _log1p(x: Floats) -> _Parts:
    inverse = 1 / (1 + x)
    return np.log1p(x), inverse, -inverse * inverse


def _reciprocal(x: Floats) -> _Parts:
    inverse = 1 / x
    return inverse, -inverse * inverse, 2 * inverse * inverse * inverse


def _square(x: Floats) -> _Parts:
    return x * x, 2 * x, np.full_like(x, 2)


def _negative(x: Floats) -> _Parts:
    return -x, np.full_like(x, -1), np.zeros_like(x)


_UNARY: dict[Any, Callable[[Floats], _Parts]] = {
    np.negative: _negative,
    np.sqrt: _sqrt,
    np.square: _square,
    np.reciprocal: _reciprocal,
    np.exp: _exp,
    np.expm1: _expm1,
    np.log: _log,
    np.log1p: _log1p,
    np.sin: _sin,
    np.cos: _cos,
    np.tan: _tan,
    np.tanh: _tanh,
    np.arctan: _arctan,
}
_BINARY: dict[Any, Callable[[Any, Any], Any]] = {
    np.add: _add,
    np.subtract: _subtract,
    np.multiply: _multiply,
    np.true_divide: _divide,
    np.power: _power,
    np.arctan2: _arctan2,
}
_COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal)


TIME, ALONG, ACROSS = range(3)
"""Indices of the variables: t, and the surface coordinates a and b."""

VALUE, T, A, B, TT, TA, TB, AA, AB, BB = range(10)
"""Rows: value, first derivatives by t, a and b, and second derivatives."""


# Limits of the series expansions. The last terms kept are below half an ulp of 80-bit floats:
# 0.5^18 / 19! = 3e-23 and 1 / 29! = 1e-31; the second derivatives are n^2 = 400 times as large.
_LARGEST_SERIES_EXP, _EXP_TERMS = 0.5, 20
_LARGEST_SERIES_SINC, _SINC_TERMS = 1.0, 14


def _with_derivatives(coefficients: list[np.longdouble]) -> tuple[list[np.longdouble], ...]:
    first = [n * c for n, c in enumerate(coefficients)][1:]
    return coefficients, first, [n * c for n, c in enumerate(first)][1:]


_EXP = _with_derivatives([1 / np.longdouble(factorial(n + 1)) for n in range(_EXP_TERMS)])
_SINC = _with_derivatives([(-1) ** n / np.longdouble(factorial(2 * n + 1)) for n in range(_SINC_TERMS)])


def exp_quotient(x: JetField) -> Any:
    """Return φ(x) = (exp(x) - 1) / x, and 1 at zero."""
    values = np.asarray(strip_derivatives(x))
    small = np.abs(values) < _LARGEST_SERIES_EXP
    if small.all():
        return compose(x, *(_polynomial(row, values) for row in _EXP))
    far = np.where(small, 1, values)
    power = np.exp(far)
    value = np.expm1(far) / far
    first = (power - value) / far
    return compose(x, *_joined(small, values, _EXP, (value, first, (power - 2 * first) / far)))


def sinc_root(q: JetField) -> Any:
    """Return sin(√q) / √q for q >= 0, and 1 at zero; sin(x) / x is its value at x²."""
    values = np.asarray(strip_derivatives(q))
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
    # Terms below 53-bit precision are omitted: 0.5^14 / 15! = 5e-17, with n^2 = 200 for the second derivative.
    kept = coefficients if x.dtype == np.longdouble else coefficients[:16]
    numbers = [x.dtype.type(c) for c in kept]
    result = np.full_like(x, numbers[-1])
    for number in numbers[-2::-1]:
        result *= x
        result += number
    return result

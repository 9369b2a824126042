"""Functions with a removable gap at zero, against 40 digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as some

from scenetruth.scene.taylor import Jet, exp_quotient, sinc_root


def series_exp(x: Any) -> Any:
    return mpmath.nsum(lambda n: x**n / mpmath.factorial(n + 1), [0, mpmath.inf])


def series_sinc(q: Any) -> Any:
    return mpmath.nsum(lambda n: (-q) ** n / mpmath.factorial(2 * n + 1), [0, mpmath.inf])


def formula_exp(x: Any) -> Any:
    return mpmath.expm1(x) / x


def formula_sinc(q: Any) -> Any:
    return mpmath.sin(mpmath.sqrt(q)) / mpmath.sqrt(q)


CASES = {
    "exp_quotient": (exp_quotient, series_exp, formula_exp, -1.0),
    "sinc_root": (sinc_root, series_sinc, formula_sinc, 0.0),
}


@pytest.mark.parametrize("name", list(CASES))
@pytest.mark.parametrize("dtype", [np.float64, np.longdouble])
@settings(deadline=None, max_examples=30)
@given(x=some.floats(0, 15), sign=some.sampled_from([-1, 1]))
@example(x=0.0, sign=1)
@example(x=1e-9, sign=1)
@example(x=0.5, sign=-1)
@example(x=1.0, sign=1)
@example(x=0.9999, sign=1)
def test_value_and_derivatives(name: str, dtype: Any, x: float, sign: int) -> None:
    function, series, formula, lowest = CASES[name]
    x = x * sign if lowest < 0 else x
    # A second point makes both branches run in one call.
    found = function(Jet.variable(np.array([x, 3.0], dtype=dtype), 0, 1))
    with mpmath.workdps(40):
        at = mpmath.mpf(x)
        reference: Callable[[Any], Any] = series if abs(x) < 2 else formula
        expected = [reference(at), mpmath.diff(reference, at), mpmath.diff(reference, at, 2)]
        scale = max(1, abs(expected[0]))
        # Formulas divide twice by arguments of 0.5 or 1: a few tens of roundings.
        tolerance = 60 * float(np.finfo(dtype).eps)
        for value, number in zip(found.coefficients[:, 0], expected, strict=True):
            assert abs(mpmath.mpf(str(value)) - number) <= tolerance * scale
    alone = function(np.array([x], dtype=dtype))
    assert alone.dtype == dtype
    assert alone[0] == pytest.approx(found.value[0], rel=4 * float(np.finfo(dtype).eps))

"""Second-order Taylor arithmetic against mpmath's derivatives, and functions with a removable gap against 40 digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as some

from scenetruth.scene import taylor_kernels as jet_kernels
from scenetruth.scene.taylor import Jet, _Plain, compose, exp_quotient, sinc_root, strip_derivatives, where
from tests.helpers.nightly import by_night

numbers = some.floats(0.2, 1.3)

FORMULAS: dict[str, Callable[[Any, Any, Any, Any], Any]] = {
    "arithmetic": lambda m, t, a, b: (a * b - t) / (b + 2 * t) + (3 - a) * 0.5 - b / 4 + 1 / a,
    "powers": lambda m, t, a, b: a**3 + b**2 * t**1 + t**0.5 - a**-2 + b**0,
    "elementary": lambda m, t, a, b: m.sin(a * t) + m.cos(b) * m.exp(-a) + m.log(t + b) * m.sqrt(a + b * b),
    "others": lambda m, t, a, b: m.tanh(a * b) + m.tan(t * a / 2) + m.atan2(a - 2 * b, t) + m.expm1(b * t),
    "quadrants": lambda m, t, a, b: m.atan2(a, b - 2) * m.atan2(-t, a * b),
}


class Elementary:
    """NumPy's functions under mpmath's names."""

    atan2 = np.arctan2

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=list(FORMULAS))
@settings(deadline=None)
@given(t=numbers, a=numbers, b=numbers)
def test_all_derivatives_against_extended_precision(
    formula: Callable[[Any, Any, Any, Any], Any], t: float, a: float, b: float
) -> None:
    jets = [Jet.variable(np.array([value]), index, 3) for index, value in enumerate((t, a, b))]
    found = formula(Elementary(), *jets)
    with mpmath.workdps(40):
        for i in range(3):
            orders = [0, 0, 0]
            orders[i] += 1
            expected = mpmath.diff(lambda *at: formula(mpmath, *at), (t, a, b), tuple(orders))
            assert found.first(i)[0] == pytest.approx(float(expected), rel=1e-11, abs=1e-11)
            for j in range(3):
                orders = [0, 0, 0]
                orders[i] += 1
                orders[j] += 1
                expected = mpmath.diff(lambda *at: formula(mpmath, *at), (t, a, b), tuple(orders))
                assert found.second(i, j)[0] == pytest.approx(float(expected), rel=1e-9, abs=1e-9)
        assert found.value[0] == pytest.approx(
            float(formula(mpmath, *map(mpmath.mpf, (t, a, b)))), rel=1e-12, abs=1e-12
        )


@pytest.mark.parametrize("variables", [1, 2, 3])
@pytest.mark.parametrize("lengths", [(700, 700), (1, 700), (700, 1), (1, 1)])
def test_kernels_against_plain_numpy(variables: int, lengths: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    rows = 1 + variables + variables * (variables + 1) // 2
    x, y = (random.normal(size=(rows, length)) for length in lengths)
    np.testing.assert_allclose(jet_kernels.multiply(x, y), _Plain.multiply(x, y), rtol=1e-13, atol=1e-14)
    parts = [random.normal(size=lengths[0]) for _ in range(3)]
    np.testing.assert_allclose(jet_kernels.compose(x, *parts), _Plain.compose(x, *parts), rtol=1e-13, atol=1e-14)


def test_extended_precision_stays_extended() -> None:
    x = Jet.variable(np.array([0.5], dtype=np.longdouble), 0, 1)
    result = np.sin(x * x) / (x + 1)
    assert result.coefficients.dtype == np.longdouble
    # Against the formula's own derivatives: 2 x cos(x^2) / (1 + x) - sin(x^2) / (1 + x)^2.
    half = np.longdouble(0.5)
    expected = 2 * half * np.cos(half**2) / (1 + half) - np.sin(half**2) / (1 + half) ** 2
    assert abs(result.first(0)[0] - expected) <= 4e-19


def test_choice_comparison_and_numbers() -> None:
    x = Jet.variable(np.linspace(-1, 1, 5), 0, 1)
    assert (x > 0).tolist() == [False, False, False, True, True]
    bent = where(x > 0, x * x, 0.0)
    assert bent.value.tolist() == [0, 0, 0, 0.25, 1]
    assert bent.first(0).tolist() == [0, 0, 0, 1, 2]
    assert where(np.array([True]), 1.0, 2.0).tolist() == [1.0]
    assert strip_derivatives(x).tolist() == np.linspace(-1, 1, 5).tolist()
    assert compose(np.array([1.0]), np.array([5.0]), np.array([0.0]), np.array([0.0])).tolist() == [5.0]
    moved = np.ones(5) - Jet.variable(np.array([2.0]), 0, 1)
    assert moved.value.tolist() == [-1] * 5
    assert moved.first(0).tolist() == [-1] * 5
    with pytest.raises(TypeError, match="must be a number"):
        x**x
    with pytest.raises(TypeError):
        np.floor(x)


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
@pytest.mark.parametrize("dtype", [np.float64, *by_night(np.longdouble)])
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

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.dataset.expression import FUNCTIONS, Expression

numbers = st.floats(-1e3, 1e3).map(lambda value: round(value, 3))
terms = st.recursive(
    st.one_of(numbers.map(lambda value: f"({value!r})"), st.sampled_from(["a", "b", "pi"])),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "//", "%"]), inner).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        inner.map(lambda text: f"-{text}"),
        st.tuples(st.sampled_from(["abs", "sin", "cos", "floor"]), inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(inner, inner, inner).map(lambda t: f"({t[0]} if {t[1]} > {t[2]} else {t[1]})"),
    ),
    max_leaves=12,
)


@given(terms, numbers, numbers)
def test_it_computes_what_python_would(text: str, a: float, b: float) -> None:
    try:
        expected = eval(text, {"__builtins__": {}}, {**FUNCTIONS, "pi": math.pi, "a": a, "b": b})  # the yardstick
    except ArithmeticError:
        with pytest.raises(ValueError, match="has no value"):
            Expression(text).value({"a": a, "b": b})
        return
    if math.isfinite(expected):
        assert Expression(text).value({"a": a, "b": b}) == expected


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "a.__class__",
        "[1, 2][0]",
        "lambda: 1",
        "(a := 3)",
        "'text'",
        "True",
        "f'{a}'",
        "a if",
        "",
        "min(*a)",
        "round(1.5, ndigits=1)",
        "1 < a < 3",
        "(" * 300 + "1" + ")" * 300,
        "-" * 200 + "1",
        "1+" * 600 + "1",
    ],
)
def test_it_refuses_all_but_arithmetic(text: str) -> None:
    with pytest.raises(ValueError, match=r"not arithmetic|formula|nested|characters"):
        Expression(text)


@pytest.mark.parametrize("text", ["1 / 0", "10.0 ** 400", "(-8) ** 0.5", "log(0)", "9**9**9**9", "a > 1"])
def test_without_a_finite_value_it_says_so(text: str) -> None:
    with pytest.raises(ValueError, match=r"has no value|not a finite number"):
        Expression(text).value({"a": 2.0})


def test_names_are_those_of_values() -> None:
    assert Expression("sin(a) + pi * b_mm").names == {"a", "b_mm"}
    with pytest.raises(ValueError, match="'b_mm' is not a number"):
        Expression("b_mm").value({"b_mm": "wide"})

"""What varies, as it is spelled."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.design.sweeps import Factor, format_level, parse_factors, split_assignments

NUMBERS = st.floats(min_value=1e-6, max_value=1e6)


def one(spelled: object, sobol: int = 0) -> Factor:
    found, problems = parse_factors({"a.b": spelled}, sobol)
    assert problems == []
    return found[0]


def test_lists_are_yaml() -> None:
    assert one("1, 2.5, 1e-3").values == (1, 2.5, 0.001)
    assert one("ideal, {kind: gaussian, noise_std: 0.1}, null").values == (
        "ideal",
        {"kind": "gaussian", "noise_std": 0.1},
        None,
    )
    assert one(np.array([1.0, 2.0])).values == (1.0, 2.0)
    assert type(one(np.array([1, 2])).values[0]) is int


def test_ranges_are_linear_or_logarithmic() -> None:
    assert one("1..10:4").listed(whole=False) == (1.0, 4.0, 7.0, 10.0)
    assert one("0.001..1:4log").listed(whole=False) == (0.001, 0.01, 0.1, 1.0)
    assert one("-.5..+.5:3").listed(whole=False) == (-0.5, 0.0, 0.5)
    assert one("3..9:4").listed(whole=True) == (3, 5, 7, 9)
    # Some values are rounded to the same.
    assert one("1..4:9").listed(whole=True) == (1, 2, 3, 4)
    assert one("1..10", sobol=4).is_filled
    assert one("1..10:log", sobol=4).logarithmic


@given(low=NUMBERS, factor=st.floats(min_value=1.01, max_value=1e6), count=st.integers(2, 40), log=st.booleans())
def test_values_of_a_range_are_evenly_spaced_between_its_ends(low: float, factor: float, count: int, log: bool) -> None:
    high = low * factor
    values = np.array(one(f"{low!r}..{high!r}:{count}{'log' if log else ''}").listed(whole=False))
    assert len(values) == count
    # Values are rounded to twelve digits.
    assert values[0] == pytest.approx(low, rel=1e-11)
    assert values[-1] == pytest.approx(high, rel=1e-11)
    steps = np.diff(np.log(values) if log else values)
    assert steps == pytest.approx(np.full(count - 1, steps.mean()), rel=1e-6, abs=1e-11 * abs(math.log(high)))


@pytest.mark.parametrize(
    ("spelled", "sobol", "told"),
    [
        ("1..10", 0, "a.b: requires a number of levels, for example 1..10:4"),
        ("10..1:4", 0, "lower end below its upper end"),
        ("0..1:4log", 0, "must be above 0"),
        ("1..10:1", 0, "must have 2 to 10,000 levels"),
        ("1..10:4lin", 0, "must have the form 1,2,5 or 1..10:4"),
        ("1..", 0, "must have the form"),
        ("[1,2", 0, "must have the form"),
        ("5", 0, "must have at least two levels"),
        ("1, 2, 1.0", 0, "has duplicate levels: 1"),
        (3, 0, "must be a list of values"),
        ([], 0, "must have at least two levels"),
        ("1,2", 8, "sobol: requires a range"),
    ],
)
def test_what_cannot_vary_is_told(spelled: object, sobol: int, told: str) -> None:
    _, problems = parse_factors({"a.b": spelled}, sobol)
    assert len(problems) == 1
    assert told in str(problems[0])


def test_assignments_are_split_at_the_first_sign() -> None:
    found, problems = split_assignments(["a=1,2", "b", "=3", "a=4,5", "c={d: 1},{d: 2}"])
    assert found == {"a": "1,2", "c": "{d: 1},{d: 2}"}
    assert [problem.path for problem in problems] == ["--vary", "--vary", "vary.a"]
    assert parse_factors({}, 0)[1][0].path == "vary"


def test_values_that_are_no_numbers_are_called_as_in_yaml() -> None:
    assert [format_level(value) for value in (True, None, 2, 0.1 + 0.2, [1, 2], {"a": 1})] == [
        "true",
        "null",
        "2",
        "0.3",
        "[1, 2]",
        "{a: 1}",
    ]

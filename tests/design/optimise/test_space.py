"""Values of free parameters, and the numbers that stand for them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Parameter

RANGES = [
    Parameter("real", 2.0, 40.0),
    Parameter("log", 0.001, 20.0, logarithmic=True),
    Parameter("whole", 2.0, 9.0, whole=True),
    Parameter("whole log", 1.0, 500.0, logarithmic=True, whole=True),
    Parameter("choice", choices=(60, "a", None, {"kind": "gaussian"})),
]


@pytest.mark.parametrize("parameter", RANGES, ids=lambda one: one.name)
@given(unit=some.floats(0, 1))
def test_a_value_stands_for_its_own_number(parameter: Parameter, unit: float) -> None:
    value = parameter.value(unit)
    again = parameter.value(min(max(parameter.unit(value), 0.0), 1.0))
    if isinstance(value, float):
        # Values have four digits: half of the last is 5e-4 of the value at most.
        assert again == pytest.approx(value, rel=5e-4)
    else:
        assert again == value


@pytest.mark.parametrize("parameter", RANGES[:4], ids=lambda one: one.name)
def test_ranges_reach_their_ends_and_no_farther(parameter: Parameter) -> None:
    values = [parameter.value(unit / 1000) for unit in range(1001)]
    assert (min(values), max(values)) == (parameter.low, parameter.high)
    assert sorted(values) == values


def test_whole_numbers_and_choices_are_equally_likely() -> None:
    for parameter in (RANGES[2], RANGES[4]):
        told: list[Any] = [str(parameter.value((n + 0.5) / 8000)) for n in range(8000)]
        assert {told.count(value) for value in set(told)} == {8000 // parameter.levels}


def test_a_logarithmic_range_is_even_in_factors() -> None:
    assert RANGES[1].value(0.5) == pytest.approx(math.sqrt(0.001 * 20), rel=1e-3)


def test_points_and_values_of_a_space() -> None:
    space = DesignSpace(tuple(RANGES))
    values = space.values([0.1, 0.2, 0.3, 0.4, 0.9])
    assert space.names == list(values)
    assert space.values(space.point(values)) == values

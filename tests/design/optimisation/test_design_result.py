"""A design in words."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from scenetruth.design.optimisation import (
    Discrepancy,
    PredictionInterval,
    RigDesign,
    Sensitivity,
    compose_summary,
    compute_prediction_interval,
    format_parameter,
)
from tests.helpers.small_specification import objective


@pytest.mark.parametrize(
    ("wanted", "simulated", "verdict"),
    [
        (0.5, (), "target 0.5: Undecided: the prediction meets it, without a simulation"),
        (0.1, (), "target 0.1: Undecided: the prediction does not meet it, without a simulation"),
        (0.5, (0.29, 0.3, 0.31), "target 0.5: Yes: at most"),
        (0.5, (0.2, 0.3, 0.7), "target 0.5: Undecided: "),
        (0.5, (0.3,), "target 0.5: Undecided: one recording cannot decide it"),
        # The prediction would reach it, and the simulation does not.
        (0.25, (0.29, 0.3, 0.31), "target 0.25: No: at least"),
    ],
)
def test_targets_are_decided_by_simulations(wanted: float, simulated: tuple[float, ...], verdict: str) -> None:
    entries = {"depth": compute_prediction_interval(simulated)} if simulated else {}
    figures = {"depth": {"scaled_median_abs_error": simulated}}
    rig = RigDesign(3, {"stage.baseline_mm": 4.25}, {}, {"depth": 0.2}, entries, (), None, "", figures)
    lines = compose_summary((objective(wanted=wanted),), rig, (), (), ())
    assert lines[0] == "recommended, rig 3: stage.baseline_mm = 4.25"
    assert lines[1].startswith("depth: scaled median absolute error, predicted 0.2 mm")
    assert verdict in lines[1]


def test_the_rms_error_stands_beside_a_typical_one() -> None:
    figures = {"depth": {"scaled_median_abs_error": (0.3, 0.3), "rmse": (0.7, 0.7)}}
    rig = RigDesign(3, {}, {}, {"depth": 0.2}, {"depth": PredictionInterval(0.3, 0.2, 0.4, 2)}, (), None, "", figures)
    assert "from 2 seeds; RMSE 0.7)" in compose_summary((objective(),), rig, (), (), ())[1]
    of_rms = replace(objective(), statistic="rmse")
    assert compose_summary((of_rms,), rig, (), (), ())[1].endswith("from 2 seeds)")


def test_one_seed_has_no_interval() -> None:
    rig = RigDesign(3, {}, {}, {"depth": 0.2}, {"depth": PredictionInterval(0.3, math.nan, math.nan, 1)}, (), None, "")
    line = compose_summary((objective(),), rig, (), (), ())[1]
    assert "simulated 0.3 (from one seed: no interval)" in line
    assert "nan" not in line


def test_changes_both_ways_are_told_the_largest_first() -> None:
    rig = RigDesign(3, {}, {}, {"depth": 0.2}, {}, (), None, "")
    nothing = (math.nan,) * 4
    effects = [
        Sensitivity("a", "depth", *nothing, 0.02, -0.019),
        Sensitivity("b", "depth", *nothing, -0.091, 0.111),
        Sensitivity("c", "depth", *nothing, math.nan, math.nan),
    ]
    (line,) = compose_summary((objective(),), rig, effects, (), ())[2:]
    assert (
        line
        == "an increase (decrease) of each parameter by 10 % changes depth by: b -9.1 % (+11.1 %), a +2.0 % (-1.9 %)"
    )


@pytest.mark.parametrize(
    ("notable", "line"),
    [
        ([False], "the simulated value agrees with its prediction, within the scatter of seeds or 30 %"),
        ([True], "the simulated value differs notably from its prediction"),
        ([False, False], "all 2 simulated values agree with their prediction, within the scatter of seeds or 30 %"),
        ([False, True], "1 of 2 simulated values differ notably from their prediction"),
    ],
)
def test_simulations_are_compared_with_predictions(notable: list[bool], line: str) -> None:
    rig = RigDesign(3, {}, {}, {"depth": 0.2}, {}, (), None, "")
    interval = PredictionInterval(0.3, 0.2, 0.4, 2)
    found = [Discrepancy(n, "depth", 0.2, interval, 1.5, each, "says") for n, each in enumerate(notable)]
    lines = list(compose_summary((objective(),), rig, (), found, ())[2:])
    assert lines == [line, *(f"rig {n}: says" for n, each in enumerate(notable) if each)]


def test_values_as_people_write_them() -> None:
    assert (format_parameter(0.123456), format_parameter(3), format_parameter("air_bearing")) == (
        "0.1235",
        "3",
        "air_bearing",
    )

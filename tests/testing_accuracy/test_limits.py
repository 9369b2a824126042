"""Limits as tests spell them: names with units, statistics, multiples of the bound; all that is wrong at once."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.scoring import QUANTITIES, STATISTICS
from scenetruth.testing.tolerances import KEYS, Limit, evaluate_limit, read_limits


def test_every_quantity_that_is_scored_can_be_limited_in_its_unit() -> None:
    assert {name for key in KEYS.values() for name in key.quantities} == set(QUANTITIES)
    for key in KEYS.values():
        units = {QUANTITIES[name].units for name in key.quantities}
        assert len(units) == 1, key
        (unit,) = units
        assert (key.units or "1") == ("1/h" if key.factor != 1 else unit)
    assert {name: KEYS[name].quantities for name in ("depth_mm", "flow_px", "velocity_mm", "growth_per_hour")} == {
        "depth_mm": ("depth",),
        "flow_px": ("flow_x", "flow_y"),
        "velocity_mm": ("velocity_x", "velocity_y", "velocity_z"),
        "growth_per_hour": ("growth_rate",),
    }
    # 1 % per hour is 0.01 per hour.
    assert KEYS["growth_per_hour"].factor == 0.01 * KEYS["growth_percent_per_hour"].factor


def test_a_number_limits_the_rms_and_a_mapping_what_it_names() -> None:
    assert read_limits({"depth_mm": 0.2}) == ([Limit("depth", "rmse", most=0.2, units="mm")], [])
    limits, problems = read_limits(
        {"depth_mm": {"bias": 0.1, "density": 0.9, "p95_abs_error": (0.1, 0.3)}}, min_density=0.5
    )
    assert problems == []
    assert [(limit.statistic, limit.least, limit.most) for limit in limits] == [
        ("bias", -0.1, 0.1),
        ("density", 0.9, math.inf),
        ("p95_abs_error", 0.1, 0.3),
        ("density", 0.5, math.inf),
    ]


@pytest.mark.parametrize(
    ("text", "multiple"),
    [("1.5 x bound", 1.5), ("2×bound", 2.0), ("3 * Bound", 3.0), ("bound", 1.0), ("1e1 x bound", 10.0)],
)
def test_multiples_of_the_bound(text: str, multiple: float) -> None:
    limits, problems = read_limits({"disparity_px": text})
    assert (limits[0].of_bound, limits[0].statistic, problems) == (multiple, "rmse", [])


@pytest.mark.parametrize(
    ("given_limits", "path", "said"),
    [
        ({"dispraity_px": 1.0}, "dispraity_px", "did you mean 'disparity_px'?"),
        ({"depth_um": 1.0}, "depth_um", "did you mean 'depth_mm'?"),
        ({"depth": 1.0}, "depth", "did you mean 'depth_mm'?"),
        ({"velocity_q_mm": 1.0}, "velocity_q_mm", "did you mean 'velocity_"),
        ({"colour": 1.0}, "colour", "available: depth_mm, "),
        ({"depth_mm": {"rmes": 1.0}}, "depth_mm.rmes", "did you mean 'rmse'?"),
        ({"depth_mm": {7: 1.0}}, "depth_mm.7", "available: bias"),
        ({"depth_mm": {}}, "depth_mm", "has no limit"),
        ({"depth_mm": -1.0}, "depth_mm.rmse", "must not be negative"),
        ({"depth_mm": math.nan}, "depth_mm.rmse", "must be a number"),
        ({"depth_mm": True}, "depth_mm.rmse", "must be a number"),
        ({"depth_mm": None}, "depth_mm.rmse", "must be a number"),
        ({"depth_mm": (2.0, 1.0)}, "depth_mm.rmse", "must be two numbers"),
        ({"depth_mm": "2 x bund"}, "depth_mm.rmse", "a multiple of the bound"),
        ({"depth_mm": "0 x bound"}, "depth_mm.rmse", "a multiple of the bound"),
        ({"depth_mm": "1..5 x bound"}, "depth_mm.rmse", "a multiple of the bound"),
        ({"depth_mm": {"median_abs_error": "2 x bound"}}, "depth_mm.median_abs_error", "only rmse"),
        ({"normal_deg": "2 x bound"}, "normal_deg.rmse", "has no bound"),
        ({}, "limits", "specify at least one"),
    ],
)
def test_what_is_no_limit_is_told(given_limits: dict[str, Any], path: str, said: str) -> None:
    _, problems = read_limits(given_limits)
    assert [problem.path for problem in problems] == [path]
    assert said in problems[0].message


def test_all_that_is_wrong_is_told_once() -> None:
    _, problems = read_limits({"flow_px": -1.0, "depht_mm": 1.0, "depth_mm": {"rmes": 1}}, min_density=1.5)
    assert [problem.path for problem in problems] == ["flow_px.rmse", "depht_mm", "depth_mm.rmes", "min_density"]


numbers = some.floats(-1e6, 1e6, allow_subnormal=False)


@given(statistic=some.sampled_from(STATISTICS[:-1]), found=numbers, bounds=some.tuples(numbers, numbers))
def test_times_is_above_one_just_where_a_limit_is_broken(
    statistic: str, found: float, bounds: tuple[float, float]
) -> None:
    low, high = sorted(bounds)
    for least, most in ((low, high), (-math.inf, abs(high)), (abs(low), math.inf)):
        # Errors are not negative but for their mean, which always has two bounds.
        value = found if least == low else abs(found)
        outcome = evaluate_limit(Limit("depth", statistic, least, most), {statistic: value, "density": 0.5, "count": 3})
        times = outcome.times
        assert times is not None
        # At the limit itself, rounding decides.
        if not math.isclose(times, 1, rel_tol=1e-9):
            assert outcome.kept == (times < 1)


@pytest.mark.parametrize(
    ("values", "note"),
    [
        (None, "not in the estimate"),
        ({"rmse": None, "density": 0.0, "count": 0}, "no scored pixels"),
        ({"rmse": None, "density": None, "count": 0}, "no truth in the region"),
        ({"rmse": None, "density": 1.0, "count": 5}, "undefined"),
        ({"rmse": math.nan, "density": 1.0, "count": 5}, "undefined"),
    ],
)
def test_what_is_undefined_is_never_kept(values: dict[str, Any] | None, note: str) -> None:
    outcome = evaluate_limit(Limit("depth", "rmse"), values)
    assert (outcome.kept, outcome.times, outcome.shown_found) == (False, None, note)


def test_a_multiple_of_a_bound_that_nobody_knows_is_never_kept() -> None:
    values = {"rmse": 0.0, "density": 1.0, "count": 5}
    limit = Limit("depth", "rmse", of_bound=2.0, units="mm")
    assert not evaluate_limit(limit, values).kept
    outcome = evaluate_limit(limit, values, bound=0.25)
    assert outcome.kept
    assert outcome.shown_limit == "<= 0.5 mm (2 x bound)"

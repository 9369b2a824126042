"""Results: what is saved is loaded again, values name unit, region and statistic, and unknown names are refused."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.design import PatternAssessment, PatternRig
from scenetruth.design.sweeps import SweepRecord
from scenetruth.results import QuantityValue, Result, from_plain_data, to_plain_data
from tests.helpers.prediction_scenes import wall
from tests.helpers.sample_budget import budget_of_a_cube
from tests.helpers.sample_design import design as sample_design
from tests.helpers.synthetic_case import make_case


def a_score() -> st.Score:
    case = make_case()
    return st.score(case.estimate, case.truth, case.recording)


def a_prediction() -> st.Prediction:
    return st.predict(wall(), model="maps", method="refined")


def a_sweep() -> st.Sweep:
    def record(level: float, value: float, **more: Any) -> SweepRecord:
        place = {"seed": None, "region": "interior", "quantity": "depth", "statistic": "rmse", "unit": "mm"} | more
        return SweepRecord({"stage.baseline_mm": level, "sensor": "ideal"}, "scene", "refined", value=value, **place)

    rows = [record(2.0, 0.4, ci_low=0.3, ci_high=0.5), record(4.0, 0.2), record(4.0, math.nan, statistic="bias")]
    return st.Sweep(["stage.baseline_mm", "sensor"], ["scene"], ["refined"], rows, ["lost"], ["a note"], Path("x"))


def a_benchmark() -> st.BenchmarkResult:
    def near(recording: xr.Dataset) -> dict[str, Any]:
        return {"depth": np.full(recording["image"].shape[-2:], 700.0)}

    return st.compare(near, cases=["disparity"], levels=[1.3], seeds=[4])


def a_pattern() -> PatternAssessment:
    rig = PatternRig.from_scene(focal_length_px=2500, distance_mm=500, baseline_mm=5, positions=5)
    return st.assess_pattern(st.generate_pattern(rig, size_mm=(20, 20), seed=1))


MAKERS: dict[str, tuple[Callable[[], Any], dict[str, Any]]] = {
    "score": (a_score, {"quantity": "depth"}),
    "prediction": (a_prediction, {"quantity": "depth"}),
    "budget": (budget_of_a_cube, {"quantity": "depth"}),
    "sweep": (a_sweep, {"quantity": "depth", "at": {"stage.baseline_mm": 2.0}}),
    "benchmark": (a_benchmark, {"quantity": "depth", "case": "disparity", "method": "near"}),
    "design": (sample_design, {"quantity": "depth", "region": "object_sheet"}),
    "pattern": (a_pattern, {"quantity": "depth_mm"}),
}


@pytest.fixture(scope="module", params=MAKERS)
def made(request: pytest.FixtureRequest) -> tuple[Any, dict[str, Any]]:
    maker, asked = MAKERS[request.param]
    return maker(), asked


def equal(one: Any, other: Any) -> bool:
    """Whether two values are the same; NaN is equal to NaN."""
    return bool(to_plain_data(one) == to_plain_data(other))


def test_what_is_saved_is_loaded(made: tuple[Any, dict[str, Any]], tmp_path: Path) -> None:
    result, asked = made
    path = tmp_path / ("design" if isinstance(result, st.DesignResult) else "result.json")
    assert result.save(path) == path
    again = type(result).load(path)
    pd.testing.assert_frame_equal(again.to_dataframe(), result.to_dataframe())
    assert again.summary() == result.summary()
    assert equal(again.to_dict(), result.to_dict())
    assert equal(again.value(**asked), result.value(**asked))
    with pytest.raises(st.OutputExistsError):
        result.save(path)
    result.save(path, overwrite=True)


def test_a_value_says_what_it_is(made: tuple[Any, dict[str, Any]]) -> None:
    result, asked = made
    value = result.value(**asked)
    assert isinstance(value, QuantityValue)
    assert math.isfinite(float(value))
    assert value.unit == "mm"
    assert value.region
    assert value.statistic
    assert value.unit in repr(value)
    assert value.region in repr(value)


def test_what_there_is_not_is_refused(made: tuple[Any, dict[str, Any]]) -> None:
    result, asked = made
    for wrong in ({"quantity": "charge"}, {"statistic": "variance"}):
        with pytest.raises(st.ArgumentError):
            result.value(**{**asked, **wrong})


def test_notebooks_show_text_and_table(made: tuple[Any, dict[str, Any]]) -> None:
    result, _ = made
    html = result._repr_html_()
    assert "<table" in html
    assert isinstance(result, Result)
    assert dataclasses.is_dataclass(result)
    assert result.summary()


def test_a_score_of_a_constant_error_is_that_error() -> None:
    case = make_case()
    estimate = case.truth[["depth"]].isel(t=slice(0, 1)) + 2.0
    estimate = st.make_estimate(recording=case.recording, depth=estimate["depth"].values, t=estimate["t"].values)
    value = st.score(estimate, case.truth, case.recording, allow_mismatch=True).value("depth", "bias")
    # Estimates are float32: half a unit in the last place at 700 mm.
    assert value.value == pytest.approx(2.0, abs=700 * 2**-24)
    assert (value.unit, value.statistic, value.region) == ("mm", "bias", "interior")
    assert value.n is not None
    assert 0 < value.n <= 160 * 120


def test_a_design_gives_simulated_values_where_there_are_some() -> None:
    design = sample_design()
    simulated = {rig.number: rig.simulated for rig in design.rigs if rig.simulated}
    assert simulated
    for objective in design.objectives:
        for rig in design.rigs:
            value = design.value(objective.quantity, region=objective.region, rig=rig.number)
            assert (value.statistic, value.unit) == (objective.statistic, objective.unit)
            if rig.number in simulated:
                expected = simulated[rig.number][objective.title]
                ends = pytest.approx((expected.pi_low, expected.pi_high), nan_ok=True)
                assert value.value == pytest.approx(expected.value)
                assert value.n == expected.seeds
                assert (value.ci_low, value.ci_high) == ends
            else:
                assert (value.value, value.n) == (rig.predicted[objective.title], None)


def test_files_of_other_results_are_refused(tmp_path: Path) -> None:
    budget_of_a_cube().save(tmp_path / "budget.json")
    with pytest.raises(st.StoreError, match=r"budget\.json: is not a saved Sweep: type must be 'Sweep', not 'Budget'"):
        st.Sweep.load(tmp_path / "budget.json")
    plain = json.loads((tmp_path / "budget.json").read_text())
    del plain["totals"]
    (tmp_path / "less.json").write_text(json.dumps(plain))
    with pytest.raises(st.StoreError, match="field 'totals' is missing"):
        st.Budget.load(tmp_path / "less.json")
    (tmp_path / "text.json").write_text("[1")
    with pytest.raises(st.StoreError, match="is not a saved Budget"):
        st.Budget.load(tmp_path / "text.json")
    with pytest.raises(st.StoreError, match="cannot be read"):
        st.Budget.load(tmp_path / "missing.json")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.1, 3.0])
def test_numbers_that_json_lacks_come_back(value: float) -> None:
    assert equal(from_plain_data(float, json.loads(json.dumps(to_plain_data(value)))), value)

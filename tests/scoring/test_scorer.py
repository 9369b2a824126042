"""A whole score: its numbers, and its spellings."""

from __future__ import annotations

import csv
import io
import json
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr

from scenetruth.errors import ScoreError
from scenetruth.number_format import format_number
from scenetruth.schema import STATUS_FALLBACK, STATUS_VALID
from scenetruth.scoring import Score, score
from scenetruth.scoring.statistics import RATES, STATISTICS
from scenetruth.settings import ScoreSettings
from tests.helpers.synthetic_case import (
    HELD,
    Case,
    make_case,
    make_growing_case,
    of_one_camera,
    of_one_frame,
    with_outliers,
    with_regions,
)

NAMES = (*HELD, "outliers")
BARRED = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z")
EDGES = ("boundary_0_5", "boundary_5_10", "boundary_10_20", "boundary_20_inf")
SLOPES = ("slope_0_20", "slope_20_45", "slope_45_70", "slope_70_90")
CONTRASTS = ("contrast_low", "contrast_mid", "contrast_high")
GROWTH = ("growth_rate", "growth_rate_windowed")
VELOCITY = ("velocity_x", "velocity_y", "velocity_z", "velocity_epe")


def strict(text: str) -> dict[str, object]:
    """Parse JSON as a strict reader does: no NaN, no Infinity."""

    def refuse(token: str) -> float:
        pytest.fail(f"{token} is not JSON")

    content = json.loads(text, parse_constant=refuse)
    assert isinstance(content, dict)
    return content


def test_json_has_exactly_the_agreed_keys(case: Case) -> None:
    estimate = with_outliers(case.estimate)
    content = strict(score(estimate, case.truth, metadata={"seed": 3}).to_json())
    assert list(content) == ["all", "interior", *EDGES, "metadata"]
    for region in ("all", "interior", *EDGES):
        quantities = content[region]
        assert isinstance(quantities, dict)
        assert tuple(quantities) == NAMES
        for name, values in quantities.items():
            assert tuple(values) == (RATES if name == "outliers" else STATISTICS)
    settings = json.loads(ScoreSettings().model_dump_json())
    expected = {"frames": [0], "image_size_px": [160, 120], "margin_px": 20.0, "score_settings": settings, "seed": 3}
    assert content["metadata"] == expected


def test_regions_are_those_that_the_truth_can_tell() -> None:
    case = with_regions(make_growing_case(48, 36, 380.0))
    everything = score(case.estimate, case.truth, case.recording)
    hidden = ("nonoccluded", "occluded")
    assert tuple(everything.regions) == ("all", "interior", *hidden, *SLOPES, *EDGES, *CONTRASTS)
    truth = case.truth.drop_vars(["occluded_across_cameras", "normal"])
    assert tuple(score(case.estimate, truth).regions) == ("all", "interior", *EDGES)
    bounds: dict[str, Any] = {"slope_classes_deg": (0, 22.5, 90), "boundary_classes_px": (3,)}
    named = score(case.estimate, case.truth, settings=bounds).regions
    assert tuple(named) == ("all", "interior", *hidden, "slope_0_22.5", "slope_22.5_90", "boundary_3_inf")
    for regions in (everything, score(case.estimate, case.truth, settings=bounds)):
        assert Score.from_json(regions.to_json()) == regions


def test_growth_comes_before_the_outliers() -> None:
    case = make_growing_case(48, 36, 380.0)
    result = score(with_outliers(case.estimate), case.truth, settings={"growth_window_px": 4})
    for values in result.regions.values():
        assert tuple(values) == (*NAMES[:-1], *GROWTH, "outliers")
    assert Score.from_json(result.to_json()) == result
    content = json.loads(result.to_json())
    del content["boundary_0_5"]["growth_rate"]
    del content["interior"]["growth_rate_windowed"]["rmse"]
    with pytest.raises(ScoreError) as caught:
        Score.from_json(json.dumps(content))
    paths = {problem.path for problem in caught.value.problems}
    assert {"boundary_0_5.growth_rate.bias", "interior.growth_rate_windowed.rmse"} <= paths
    assert all(path.startswith(("boundary_0_5.growth_rate.", "interior.growth_rate_windowed.")) for path in paths)


def test_recording_that_does_not_belong_is_refused(case: Case) -> None:
    with pytest.raises(ScoreError, match=r"recording\.x: lacks pixel columns of the estimate; .* \(got \[80, 81, "):
        score(case.estimate, case.truth, case.recording.isel(x=slice(80)))
    estimate, truth = (dataset.assign_coords(t=dataset.t + 10) for dataset in (case.estimate, case.truth))
    with pytest.raises(ScoreError, match=r"recording\.t: lacks frames of the estimate \(got \[10\]\)"):
        score(estimate, truth, case.recording)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"slope_classes_deg": (0, 40, 30)}, "slope_classes_deg: must be in ascending order"),
        ({"slope_classes_deg": (0, 100)}, "slope_classes_deg: must be two or more limits between 0 and 90"),
        ({"slope_classes_deg": (10,)}, "slope_classes_deg: must be two or more limits"),
        ({"boundary_classes_px": ()}, "boundary_classes_px"),
        ({"boundary_classes_px": (-1, 2)}, "boundary_classes_px.0"),
        ({"contrast_classes": (0.2, 0.1)}, "contrast_classes: must be in ascending order"),
        ({"contrast_window_px": math.inf}, "contrast_window_px"),
        ({"unknown": 1}, "unknown"),
        ({"interior_margin_px": -1.0}, "interior_margin_px"),
    ],
)
def test_impossible_settings_are_refused(case: Case, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ScoreError, match=message):
        score(case.estimate, case.truth, settings=settings)


def test_perfect_estimate_has_full_marks(case: Case) -> None:
    result = score(case.truth, case.truth)
    for quantities in result.regions.values():
        for name in NAMES[:-1]:
            assert (quantities[name]["rmse"], quantities[name]["density"]) == (0.0, 1.0)
        # With disparities that are all alike, a rate of zero says nothing.
        assert "outliers" not in quantities
        assert quantities["velocity_x"]["relative_rmse"] is None


def test_numbers_are_those_of_the_arrays(case: Case) -> None:
    result = score(case.estimate, case.truth).regions
    scored = (case.estimate["status"].values == STATUS_VALID) & np.isfinite(case.truth["depth"].values)
    error = case.estimate["depth"].values.astype(np.float64) - case.truth["depth"].values
    assert result["all"]["depth"]["count"] == scored.sum()
    assert result["all"]["depth"]["bias"] == pytest.approx(error[scored].mean())
    delta = (case.estimate["velocity"].values.astype(np.float64) - case.truth["velocity"].values)[:, scored]
    assert result["all"]["velocity_epe"]["rmse"] == pytest.approx(np.sqrt((delta**2).sum(axis=0).mean()))
    assert result["all"]["velocity_z"]["rmse"] == pytest.approx(np.sqrt((delta[2] ** 2).mean()))
    assert result["interior"]["depth"]["rmse"] < result["all"]["depth"]["rmse"]  # type: ignore[operator]


@pytest.mark.parametrize("region", ["all", "interior"])
def test_right_error_bars_are_calibrated(full_case: Case, region: str) -> None:
    result = score(full_case.estimate, full_case.truth).regions[region]
    for name in BARRED:
        count = float(result[name]["count"] or 0)
        assert count > 500
        # Five standard deviations of what so many normal errors give.
        assert result[name]["rms_z"] == pytest.approx(1, abs=5 / math.sqrt(2 * count))
        assert result[name]["coverage_2_std"] == pytest.approx(0.9545, abs=5 * math.sqrt(0.9545 * 0.0455 / count))


def test_calibration_scales_with_the_error_bars(full_case: Case) -> None:
    right = score(full_case.estimate, full_case.truth)
    stated = {f"{name}_std": full_case.estimate[f"{name}_std"] / 2 for name in ("depth", "disparity", "velocity")}
    bold = score(full_case.estimate.assign(stated), full_case.truth)
    for region in ("all", "interior"):
        for name in BARRED:
            here, there = bold.regions[region][name], right.regions[region][name]
            assert here["rms_z"] == 2 * float(there["rms_z"] or 0)
            assert float(here["coverage_2_std"] or 0) < 0.75
            assert (here["rmse"], here["density"]) == (there["rmse"], there["density"])


def test_quantities_without_error_bars_have_no_calibration(full_case: Case) -> None:
    everything = score(full_case.estimate, full_case.truth)
    partly = score(full_case.estimate.drop_vars(["depth_std", "velocity_std"]), full_case.truth)
    for region, quantities in partly.regions.items():
        for name in NAMES[:-1]:
            undefined = quantities[name]["rms_z"] is None and quantities[name]["coverage_2_std"] is None
            assert undefined == (name != "disparity")
            assert quantities[name]["rmse"] == everything.regions[region][name]["rmse"]
    strict(partly.to_json())
    frame = partly.to_dataframe()
    assert frame["rms_z"].notna().sum() == len(partly.regions)
    assert frame.loc[("all", "disparity"), "rms_z"] == partly.regions["all"]["disparity"]["rms_z"]


def test_every_quantity_counts_where_its_own_kind_is_full(full_case: Case) -> None:
    estimate = with_outliers(full_case.estimate)
    result = score(estimate, full_case.truth).regions["all"]
    seen = np.isfinite(full_case.truth["depth"].values)
    disparity, motion = (seen & (estimate[f"status_{name}"].values == STATUS_VALID) for name in ("disparity", "motion"))
    both = disparity & motion
    expected = {"depth": disparity, "disparity": disparity, "flow_x": motion, "flow_y": motion}
    for name in NAMES:
        mask = expected.get(name, both)
        assert result[name]["count"] == mask.sum(), name
        if name != "outliers":
            assert result[name]["density"] == pytest.approx(mask.sum() / seen.sum())
    assert len({int(mask.sum()) for mask in (disparity, motion, both)}) == 3


@pytest.mark.parametrize(
    ("reduce", "unknown"),
    [(of_one_camera, {"depth", "disparity", *VELOCITY}), (of_one_frame, {"flow_x", "flow_y", *VELOCITY})],
)
def test_one_camera_or_one_frame_knows_nothing_of_some(
    full_case: Case, reduce: Callable[[Case], Case], unknown: set[str]
) -> None:
    result = score(reduce(full_case).estimate, full_case.truth)
    for region, quantities in score(full_case.estimate, full_case.truth).regions.items():
        for name in NAMES[:-1]:
            values = result.regions[region][name]
            if name in unknown:
                assert values == {**dict.fromkeys(STATISTICS, None), "density": 0.0, "count": 0}
            else:
                assert values == quantities[name]
        assert "outliers" not in result.regions[region]
    strict(result.to_json())
    assert Score.from_json(result.to_json()) == result
    assert (result.to_dataframe().loc["all"].loc[sorted(unknown), "density"] == 0).all()


def test_estimate_without_kind_counts_wherever_it_is_finite(case: Case) -> None:
    result = score(case.estimate.drop_vars("status"), case.truth).regions["all"]["depth"]
    both = np.isfinite(case.estimate["depth"].values) & np.isfinite(case.truth["depth"].values)
    assert result["count"] == both.sum()


def test_margin_shrinks_the_interior(case: Case) -> None:
    counts = [
        score(case.estimate, case.truth, settings={"interior_margin_px": m}).regions["interior"]["depth"]["count"]
        for m in (0, 5, 500)
    ]
    assert counts[0] > counts[1] > counts[2] == 0  # type: ignore[operator]


def test_nothing_in_common_is_no_crash() -> None:
    case = make_case(40, 30, 320.0)
    empty = case.estimate.map(lambda values: values.where(False) if values.dtype.kind == "f" else values * 0)
    empty.attrs = case.estimate.attrs
    result = score(empty, case.truth)
    assert result.regions["all"]["depth"]["density"] == 0.0
    assert result.regions["all"]["depth"]["rmse"] is None
    no_surface = case.truth.assign(depth=case.truth["depth"] * np.nan)
    assert score(case.estimate, no_surface).regions["interior"]["depth"]["density"] is None
    strict(result.to_json())


def test_json_and_pickle_round_trip(case: Case) -> None:
    result = score(case.estimate, case.truth, metadata={"timings_s": {"estimate": 1.5}, "warnings": ["ä"]})
    assert Score.from_json(result.to_json()) == result
    assert pickle.loads(pickle.dumps(result)) == result


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "must be a JSON object"),
        ('{"all": {}, "interior": {}}', "metadata: must be a JSON object"),
        ('{"all": {}, "interior": {}, "metadata": {}, "more": 1}', "more: is neither one of the keys"),
        ('{"all": {}, "interior": {}, "metadata": {}, "nonoccluded": 1}', "nonoccluded: must be a JSON object"),
        (
            '{"all": {}, "interior": {}, "metadata": {}, "nonoccluded": {}}',
            "all: must have at least one of depth, dispar",
        ),
        (
            '{"all": {"depth": {}}, "interior": {}, "metadata": {}, "nonoccluded": {}}',
            "nonoccluded.depth.rmse: is missing",
        ),
        ('{"all": {"flow_x": {}}, "interior": {}, "metadata": {}}', "interior.flow_y.rmse: is missing"),
        (
            '{"all": {"depth": {}, "outliers": {"flow_rate": 0}}, "interior": {}, "metadata": {}}',
            "interior.outliers.flow_rate: is missing",
        ),
        ('{"all": {"depth": {}}, "interior": 1, "metadata": {}}', "all.depth.rmse: is missing"),
    ],
)
def test_foreign_json_is_refused(text: str, message: str) -> None:
    with pytest.raises(ScoreError, match=message):
        Score.from_json(text)


def test_metadata_become_plain(case: Case) -> None:
    given = {
        "array": np.arange(2),
        "float": np.float32(0.5),
        "path": Path("a"),
        "nan": math.nan,
        "deep": {1: (None, True)},
    }
    plain = score(case.estimate, case.truth, metadata=given).metadata
    assert {key: plain[key] for key in given} == {
        "array": [0, 1],
        "float": 0.5,
        "path": "a",
        "nan": None,
        "deep": {"1": [None, True]},
    }


def test_metadata_that_json_cannot_say_are_refused(case: Case) -> None:
    with pytest.raises(ScoreError, match=r"metadata\.a\.0: a complex cannot be written as JSON"):
        score(case.estimate, case.truth, metadata={"a": [1j]})


def test_frame_holds_every_number(case: Case) -> None:
    result = score(with_outliers(case.estimate), case.truth)
    frame = result.to_dataframe()
    assert frame.index.names == ["region", "quantity"]
    assert list(frame.index) == [(region, name) for region in ("all", "interior", *EDGES) for name in NAMES]
    assert frame.loc[("all", "depth"), "units"] == "mm"
    assert frame.loc[("interior", "velocity_epe"), "rmse"] == result.regions["interior"]["velocity_epe"]["rmse"]
    assert np.isnan(frame.loc[("all", "outliers"), "rmse"])
    assert np.isnan(frame.loc[("all", "velocity_x"), "relative_rmse"])


def test_csv_leaves_undefined_values_empty(case: Case) -> None:
    result = score(with_outliers(case.estimate), case.truth)
    rows = {(row["region"], row["quantity"]): row for row in csv.DictReader(io.StringIO(result.to_csv()))}
    assert len(rows) == 6 * len(NAMES)
    depth = rows["all", "depth"]
    assert depth["units"] == "mm"
    assert float(depth["rmse"]) == result.regions["all"]["depth"]["rmse"]
    assert int(depth["count"]) == result.regions["all"]["depth"]["count"]
    assert depth["disparity_rate"] == ""
    assert rows["all", "velocity_x"]["relative_rmse"] == ""


@pytest.mark.parametrize(
    ("held", "scored"),
    [
        (("depth", "disparity"), ("depth", "disparity")),
        (("flow",), ("flow_x", "flow_y")),
        (("disparity", "flow"), ("disparity", "flow_x", "flow_y")),
        (("velocity",), VELOCITY),
        (("depth", "velocity"), ("depth", *VELOCITY)),
    ],
)
@pytest.mark.parametrize("kinds", [True, False])
def test_what_the_estimate_holds_is_scored(
    full_case: Case, held: tuple[str, ...], scored: tuple[str, ...], kinds: bool
) -> None:
    names = ["status", "status_disparity", "status_motion"]
    whole = full_case.estimate if kinds else full_case.estimate.drop_vars(names)
    estimate = whole[[*held, *(names if kinds else ())]]
    result = score(estimate, full_case.truth, full_case.recording)
    everything = score(whole, full_case.truth, full_case.recording)
    assert list(result.regions) == list(everything.regions)
    for region, quantities in result.regions.items():
        assert tuple(quantities) == scored
        for name, values in quantities.items():
            expected = {**everything.regions[region][name], "rms_z": None, "coverage_2_std": None}
            assert values == expected
    assert Score.from_json(result.to_json()) == result
    assert len(list(csv.DictReader(io.StringIO(result.to_csv())))) == len(result.regions) * len(scored)


@pytest.mark.parametrize(
    ("held", "rates"),
    [
        (("disparity",), ("disparity_rate", "count")),
        (("flow", "depth"), ("flow_rate", "count")),
        (("disparity", "flow"), RATES),
        (("depth",), None),
    ],
)
def test_outliers_need_what_they_are_told_of(case: Case, held: tuple[str, ...], rates: tuple[str, ...] | None) -> None:
    result = score(with_outliers(case.estimate)[[*held, "status"]], case.truth)
    for quantities in result.regions.values():
        told = quantities.get("outliers")
        assert (None if told is None else tuple(told)) == rates
    assert Score.from_json(result.to_json()) == result


def test_score_has_a_short_representation(case: Case) -> None:
    result = score(case.estimate, case.truth)
    text = repr(result)
    assert "\n" not in text
    rms = result.regions["interior"]["depth"]["rmse"]
    assert text.startswith("Score(regions: all, interior and 4 more; quantities: depth, disparity, velocity, flow; ")
    assert f"depth {rms:.3g} mm" in text
    assert "velocity_epe" in text
    nothing = score(case.estimate.assign(status=0 * case.estimate["status"])[["disparity", "status"]], case.truth)
    assert repr(nothing).endswith("quantities: disparity; RMSE in the interior: disparity undefined px/step)")


def test_score_is_a_table_in_a_notebook(full_case: Case) -> None:
    result = score(full_case.estimate, full_case.truth)
    hostile = Score({**result.regions, "object_<b>&": result.regions["all"]}, result.metadata)
    html = hostile._repr_html_()
    reader = ElementTree.fromstring(f"<div>{html}</div>")
    cells = [["".join(cell.itertext()) for cell in row] for row in reader.iter("tr")]
    assert cells[0][:4] == ["region", "quantity", "unit", "bias"]
    assert len(cells) == 1 + 2 * 8
    assert cells[1][:3] == ["all", "Depth", "mm"]
    assert format_number(result.regions["interior"]["depth"]["rmse"]) in cells[9]
    assert "object_&lt;b&gt;&amp;" in html
    assert "outliers" not in html.lower()


def test_notebook_shows_growth_only_where_something_grows(case: Case) -> None:
    growing = make_growing_case(48, 36, 380.0)
    result = score(growing.estimate, growing.truth, settings={"growth_window_px": 4, "interior_margin_px": 3})
    assert "Growth rate, windowed" in result._repr_html_()
    assert "growth_rate_windowed 0 %/h" in repr(result)
    assert "Growth" not in score(case.estimate, case.truth)._repr_html_()
    assert "growth" not in repr(score(case.estimate, case.truth))


@pytest.mark.parametrize(
    "part", [{"x": slice(20, 120), "y": slice(30, 100)}, {"x": slice(None, None, 3), "y": slice(1, None, 2)}]
)
def test_part_of_the_image_is_scored_as_in_the_whole(full_case: Case, part: dict[str, slice]) -> None:
    """A pixel belongs to the same regions, whatever else the estimate shows."""
    truth = with_regions(full_case).truth
    estimate = full_case.estimate.isel(part)
    holes = full_case.estimate.reindex_like(estimate).reindex_like(full_case.estimate)
    there = np.isfinite(holes["coherence"]) | np.isfinite(holes["status_motion"])
    result = score(estimate, truth, full_case.recording)
    whole = score(full_case.estimate.where(there), truth, full_case.recording)
    inside = score(full_case.truth.isel(part), truth, full_case.recording)
    for region, quantities in result.regions.items():
        for name, values in quantities.items():
            expected = dict(whole.regions[region][name])
            # The share is that of the part.
            assert {**values, "density": None} == pytest.approx({**expected, "density": None}), (region, name)
            if values["density"] is not None:
                count = inside.regions[region][name]["count"]
                assert values["density"] == pytest.approx(float(values["count"] or 0) / float(count or 1))
    assert result.metadata["image_size_px"] == [estimate.sizes["x"], estimate.sizes["y"]]


def test_part_of_a_recording_will_do_for_contrast(full_case: Case) -> None:
    part = {"x": slice(20, 120), "y": slice(30, 100)}
    result = score(full_case.estimate.isel(part), full_case.truth, full_case.recording.isel(part))
    assert {"contrast_low", "contrast_mid", "contrast_high"} <= set(result.regions)


def test_fallback_values_are_scored_on_request(case: Case) -> None:
    """Only disparity and depth have them; other quantities are not finite there."""
    status = np.full(case.estimate["depth"].shape, STATUS_VALID, dtype=np.uint8)
    status[..., :40] = STATUS_FALLBACK
    estimate = case.estimate.assign(status_disparity=(("t", "y", "x"), status))
    estimate["velocity"] = estimate["velocity"].where(estimate["status_disparity"] == STATUS_VALID)
    without, with_them = (
        dict(score(estimate, case.truth, settings={"include_fallback": include}).regions["all"])
        for include in (False, True)
    )
    valid = estimate.assign(status_disparity=xr.full_like(estimate["status_disparity"], STATUS_VALID))
    everywhere: dict[str, Any] = dict(score(valid, case.truth).regions["all"])
    assert with_them["depth"] == everywhere["depth"]
    assert (without["depth"]["count"] or 0) < 0.9 * everywhere["depth"]["count"]
    assert with_them["velocity_z"] == without["velocity_z"]
    assert score(estimate, case.truth).regions["all"]["depth"] == without["depth"]

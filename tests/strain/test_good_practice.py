"""Fields of good practice against numbers worked out by hand; what is not stated says so."""

from __future__ import annotations

import json
import math
from io import StringIO
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.strain import GoodPracticeReport


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    return st.make_recording(
        np.zeros((3, 2, 30, 40)), focal_length_px=2000, baseline_mm=10, frame_interval_s=0.5, full_scale=255
    )


@pytest.fixture(scope="module")
def estimate(recording: xr.Dataset) -> xr.Dataset:
    shape = (2, 30, 40)
    made = st.make_estimate(
        recording=recording,
        depth=np.full(shape, 400.0),
        velocity=np.zeros((3, *shape)),
        velocity_std=np.full((3, *shape), 0.002),
        method="refined",
    )
    return made.assign_attrs(settings=json.dumps({"window_sigma_px": 4.0, "spline": "quintic"}))


def values(report: GoodPracticeReport) -> dict[str, tuple[str, str]]:
    return {each.name: (each.value, each.unit) for each in report.fields}


def test_fields_follow_from_rig_settings_and_gauge(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    strain = st.compute_strain(estimate, settings={"window": 5, "step": 3, "measure": "hencky"})
    found = values(st.report_good_practice(recording, estimate, strain))
    # 5 px per mm at 400 mm; 20 mm between the outer positions.
    assert found["Image scale"] == ("5", "px/mm")
    assert found["Field of view"] == ("8 x 6", "mm")
    assert found["Stereo angle"] == (f"{math.degrees(2 * math.atan(10 / 400)):.3g}", "°")
    assert found["Image acquisition rate"] == ("2", "Hz")
    assert found["Focal length"] == ("2000", "px")
    length = 4 * 3 + 2 * math.sqrt(math.pi) * 4
    assert found["Virtual strain gauge"] == (f"{length:.3g}", "px")
    assert found["Virtual strain gauge on the object"] == (f"{length / 5:.3g}", "mm")
    assert found["Strain formulation"][0] == "Hencky strain, ln(C) / 2"
    assert found["Interpolant"][0] == "quintic B-spline"
    assert found["Displacement U per frame"] == ("0.002", "mm")
    assert found["Displacement U per frame at the image scale"] == ("0.01", "px")
    assert float(found["Strain exx"][0]) == pytest.approx(float(np.nanmedian(strain["exx_std"])), rel=0.01)


def test_models_and_criterion_are_those_of_the_settings(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    def fields(**chosen: Any) -> dict[str, tuple[str, str]]:
        settings = RefinedSettings(**chosen).model_dump_json()
        return values(st.report_good_practice(recording, estimate.assign_attrs(settings=settings)))

    found = fields(surface="plane", motion="affine", photometric_model="none")
    assert found["Subset shape function"] == ("disparity: linear; motion: affine", "")
    assert found["Matching criterion"] == ("least squares over all images, one brightness for all images", "")
    # Every model has its words.
    for name, field in (
        ("surface", "Subset shape function"),
        ("motion", "Subset shape function"),
        ("photometric_model", "Matching criterion"),
    ):
        models = get_args(RefinedSettings.model_fields[name].annotation)
        words = {fields(**{name: model})[field][0] for model in models}
        assert len(words) == len(models)
        assert "not stated by the estimate" not in words
    # Settings that are not stated are not assumed.
    unknown = values(st.report_good_practice(recording, estimate))
    assert unknown["Subset shape function"] == unknown["Matching criterion"] == ("not stated by the estimate", "")


def test_noise_floors_are_those_of_valid_pixels(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    status = np.full(estimate["depth"].shape, 2, dtype=np.int8)
    status[..., 1::2] = 3
    std = np.where(status == 3, 9.0, 0.25)
    marked = estimate.assign(status_disparity=(("t", "y", "x"), status), depth_std=(("t", "y", "x"), std))
    assert values(st.report_good_practice(recording, marked))["Depth"] == ("0.25", "mm")
    assert values(st.report_good_practice(recording, marked.drop_vars("status_disparity")))["Depth"] == ("4.62", "mm")


def test_missing_fields_are_not_invented(recording: xr.Dataset) -> None:
    report = st.report_good_practice(recording)
    found = values(report)
    for name in ("Camera", "Lens", "Aperture", "Patterning technique", "Image scale", "Stand-off distance"):
        assert found[name] == ("not stated in the recording", "")
    assert found["Subset size"] == ("not stated by the estimate", "")
    assert found["Strain window"] == ("no strain computed", "")
    assert "Lens: not stated" in report.summary()
    assert not any("nan" in each.value for each in report.fields)


def test_results_of_other_programs_are_stated_as_theirs(recording: xr.Dataset) -> None:
    depth = np.full((2, 30, 40), 400.0)
    for method, software in (("al-dic-3d", "al-dic-3d"), ("refined", "scenetruth, method refined")):
        estimate = st.make_estimate(recording=recording, depth=depth, method=method)
        assert values(st.report_good_practice(recording, estimate))["Software"][0] == software


def test_unknown_subset_leaves_the_gauge_open(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    other = estimate.assign_attrs(settings="{}", method="external")
    found = values(st.report_good_practice(recording, other, st.compute_strain(other)))
    assert found["Virtual strain gauge"][0] == "not stated by the estimate"
    assert found["Step size"] == ("4", "px")
    assert found["Strain exx"][0] == "not stated by the estimate"


def test_table_is_saved_and_read_back(recording: xr.Dataset, estimate: xr.Dataset, tmp_path: Path) -> None:
    report = st.report_good_practice(recording, estimate)
    assert GoodPracticeReport.load(report.save(tmp_path / "report.json")) == report
    table = pd.read_csv(StringIO(report.to_csv()), keep_default_na=False)
    assert table["field"].tolist() == [each.name for each in report.fields]
    assert table["value"].tolist() == [each.value for each in report.fields]


def test_medians_are_those_of_all_frames_block_by_block() -> None:
    """Two frames of more pixels than one block has; two thirds of the valid pixels are in the second one."""
    shape = (2, 950, 800)
    recording = st.make_recording(np.zeros((1, *shape), np.uint8), focal_length_px=2000, baseline_mm=10)
    depth = np.full(shape, 400, np.float32)
    depth[0, :475] = np.nan
    depth[0, 475:] = 800
    found = values(st.report_good_practice(recording, st.make_estimate(recording=recording, depth=depth)))
    assert found["Stand-off distance"] == ("400", "mm")


def test_other_types_are_rejected(recording: xr.Dataset) -> None:
    with pytest.raises(st.ScoreError) as caught:
        st.report_good_practice(None, {})  # type: ignore[arg-type]
    assert {problem.path for problem in caught.value.problems} == {"recording", "estimate"}


def test_exchanged_data_sets_are_rejected(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    with pytest.raises(st.ScoreError) as caught:
        st.report_good_practice(estimate, recording, recording)
    assert [str(problem) for problem in caught.value.problems] == [
        "recording: must be a recording (got 'estimate')",
        "estimate: must be an estimate (got 'recording')",
        "strain: must be a strain data set (got 'recording')",
    ]

"""Simulated twins: errors to expect, what capture and twin both show, and interrupted runs."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import scenetruth as st
from scenetruth.capture import TwinPrediction, TwinRun, run_twin
from tests.helpers.command_line import scenetruth
from tests.helpers.measured_twins import MeasuredCapture, measure_scene, two_plates

MARGIN = {"interior_margin_px": 8.0}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> MeasuredCapture:
    return measure_scene(tmp_path_factory.mktemp("measured"), two_plates(seed=9))


@pytest.fixture(scope="module")
def predicted(measured: MeasuredCapture, tmp_path_factory: pytest.TempPathFactory) -> TwinRun:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        return run_twin(
            measured.capture, measured.run, tmp_path_factory.mktemp("twin") / "out", score_settings=MARGIN
        )  # fmt: skip


def test_the_predicted_errors_are_those_of_the_measurement(measured: MeasuredCapture, predicted: TwinRun) -> None:
    estimate = st.open_store(measured.run / "estimate.refined.zarr")
    obtained = st.score(estimate, st.open_store(measured.truth), settings=MARGIN, allow_mismatch=True)
    # Errors are correlated over a window of 6 px: 12,288 / (4 π 36) = 27 independent values in both, so that the
    # ratio of two standard deviations scatters by 19 %.
    for quantity in ("depth", "velocity_z"):
        rmse, bias = (obtained.value(quantity, statistic).value for statistic in ("rmse", "bias"))
        spread = np.sqrt(rmse**2 - bias**2)
        assert 0.5 < predicted.prediction.value(quantity, "pixel_std").value / spread < 2.0


def test_the_twin_shows_what_the_capture_shows(predicted: TwinRun) -> None:
    found = {each.name: each for each in predicted.prediction.comparisons}
    for name in ("residual of the fit, median", "noise of the static images, median"):
        assert found[name].ratio == pytest.approx(1.0, abs=0.08)
    assert found["RMS gradient of the reference image"].ratio == pytest.approx(1.0, abs=0.06)
    assert found["pixels with a valid depth"].ratio == pytest.approx(1.0, abs=0.06)


def test_the_output_is_complete_and_reused(measured: MeasuredCapture, predicted: TwinRun) -> None:
    place = predicted.folder
    for name in ("scene/scene.yaml", "capture/capture.yaml", "run/recording.zarr", "run/truth.zarr", "run/score.json",
                 "prediction.json", "prediction.csv", "prediction.png", "twin.json"):  # fmt: skip
        assert (place / name).exists()
    assert TwinPrediction.load(place / "prediction.json").to_dict() == predicted.prediction.to_dict()
    table = pd.read_csv(place / "prediction.csv")
    assert {"all", "interior", "object_surface_1"} <= set(table["region"])
    row = table[(table.region == "interior") & (table.quantity == "depth")].iloc[0]
    assert row.rmse**2 == pytest.approx(row.pixel_std**2 + row.bias**2 + row.common_std**2, rel=1e-9)
    # A stopped run: what is complete is not computed again, what is missing is.
    before = (place / "run" / "estimate.refined.zarr").stat().st_mtime_ns
    (place / "prediction.json").unlink()
    (place / "prediction.png").unlink()
    again = run_twin(measured.capture, measured.run, place, score_settings=MARGIN)
    assert again.prediction.to_dict() == predicted.prediction.to_dict()
    assert (place / "prediction.png").exists()
    assert (place / "run" / "estimate.refined.zarr").stat().st_mtime_ns == before


def test_a_folder_of_another_twin_is_rejected(measured: MeasuredCapture, predicted: TwinRun) -> None:
    with pytest.raises(st.OutputExistsError, match="another measurement"):
        run_twin(measured.capture, measured.run, predicted.folder, seed=4, score_settings=MARGIN)


def test_summary_and_values(predicted: TwinRun) -> None:
    text = predicted.prediction.summary()
    assert "interior" in text
    assert "note: noise from dark frames and flat fields" in text
    assert predicted.prediction.value("depth", "density").unit == "1"
    with pytest.raises(st.ArgumentError, match="region"):
        predicted.prediction.value("depth", region="moon")
    assert all(problem.path for problem in predicted.prediction.disagreements)


def test_command(measured: MeasuredCapture, tmp_path: Path) -> None:
    capture = measured.capture.folder
    place = tmp_path / "scene"
    done = scenetruth("capture", "twin", capture, measured.run, "-o", place, "--scene-only")
    assert done.returncode == 0, done.stderr
    assert "note: noise from dark frames and flat fields" in done.stdout
    assert st.load_scene(place / "scene.yaml").frames.count == 3
    done = scenetruth("capture", "twin", capture, measured.run, "-o", tmp_path / "twin", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout[done.stdout.index("{") : done.stdout.rindex("}") + 1])["type"] == "TwinPrediction"
    done = scenetruth("capture", "twin", capture, measured.run, "-o", tmp_path / "twin", "--overwrite")
    assert done.returncode == 2
    assert "--scene-only" in done.stderr
    done = scenetruth("capture", "twin", capture, tmp_path / "nothing", "-o", tmp_path / "other")
    assert done.returncode == 2
    assert "scenetruth capture import" in done.stderr

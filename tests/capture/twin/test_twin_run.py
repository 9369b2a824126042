"""Simulated twins: errors to expect, what capture and twin both show, and interrupted runs."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, TwinPrediction, TwinRun, run_twin
from scenetruth.capture.twin import make_rig
from tests.helpers.command_line import scenetruth
from tests.helpers.measured_twins import MeasuredCapture, measure_scene, two_plates
from tests.helpers.nightly import nightly

# The whole run; its parts have tests by day.
pytestmark = nightly

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


@nightly
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


def test_invalid_settings_are_rejected_before_any_work(measured: MeasuredCapture, tmp_path: Path) -> None:
    with pytest.raises(st.ScoreError, match="interior_margin_px"):
        run_twin(measured.capture, measured.run, tmp_path / "new", score_settings={"interior_margin_px": -1.0})
    assert not (tmp_path / "new").exists()


def test_summary_and_values(predicted: TwinRun) -> None:
    text = predicted.prediction.summary()
    assert "interior" in text
    assert "note: noise from dark frames and flat fields" in text
    assert predicted.prediction.value("depth", "density").unit == "1"
    with pytest.raises(st.ArgumentError, match="region"):
        predicted.prediction.value("depth", region="moon")
    assert all(problem.path for problem in predicted.prediction.disagreements)


def test_numbers_of_draws_are_checked(measured: MeasuredCapture, tmp_path: Path) -> None:
    with pytest.raises(st.ArgumentError, match="draws"):
        run_twin(measured.capture, measured.run, tmp_path / "new", draws=0)


@nightly
def test_further_draws_are_added(measured: MeasuredCapture, predicted: TwinRun) -> None:
    before = (predicted.folder / "run" / "estimate.refined.zarr").stat().st_mtime_ns
    found = run_twin(measured.capture, measured.run, predicted.folder, draws=2, score_settings=MARGIN)
    assert (predicted.folder / "run" / "estimate.refined.zarr").stat().st_mtime_ns == before
    images = [st.open_store(predicted.folder / each / "run" / "recording.zarr")["image"] for each in (".", "draw_02")]
    assert (images[0].values != images[1].values).mean() > 0.5
    one, two = (each.value("depth", "sampling_std").value for each in (predicted.prediction, found.prediction))
    # The scatter of the second simulation is about that of the first.
    assert two / one == pytest.approx(2**-0.5, rel=0.3)


@nightly
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


@nightly
def test_a_rectified_measurement_has_a_twin_of_the_real_rig(tmp_path: Path) -> None:
    lens = {"k1": -0.4, "k2": 0.5, "p1": 2e-3, "p2": -1e-3}
    camera = Camera(width=128, height=96, focal_length_px=1000, principal_point_px=(65, 46), distortion=lens)
    rig = RigCalibration.from_camera(camera, [-8.0, 0.0, 8.0], std={"f": 0.5})
    draw, scales = np.random.default_rng(3), {"axis_y": 4e-3, "axis_z": 8e-3, "step_scale": 1e-4}
    for index, name in enumerate(rig.names):
        motion = 2e-4 if name.endswith(("pitch", "yaw", "roll")) else 5e-3
        rig.values[index] += scales.get(name, motion if name.startswith("position") else 0.0) * draw.standard_normal()
    plain = two_plates()
    stated = st.capture.Capture.from_dict(
        {**{name: plain[name] for name in ("camera", "stage", "frames")}, "files": {"images": "s{s:+d}_t{t:+d}.tif"}}
    )
    # Poses in the frame of the reference camera, as for a recording that is not rectified.
    made = make_rig(stated, rig, st.make_recording(np.zeros((3, 3, 96, 128)), 1000.0, 8.0))
    scene = {**plain, "camera": made.camera, "stage": made.stage}
    measured = measure_scene(tmp_path, scene, calibration=rig)
    recording = st.open_store(measured.run / "recording.zarr")
    assert recording.attrs["geometry"] == "rectified"
    with pytest.raises(st.CaptureError, match="was rectified by one"):
        run_twin(measured.capture, measured.run, tmp_path / "twin", score_settings=MARGIN)
    rig.save(measured.run / "calibration.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        found = run_twin(measured.capture, measured.run, tmp_path / "twin", score_settings=MARGIN)
    twin = st.load_scene(found.scene)
    assert twin.camera.distortion is not None
    assert twin.stage.poses is not None
    copy = st.open_store(found.folder / "run" / "recording.zarr")
    assert copy.attrs["focal_length_px"] == pytest.approx(1000)
    assert copy.attrs["rectified_depth_mm"] == recording.attrs["rectified_depth_mm"]
    # An error of the frame by 4 to 8 mrad, the tilt of the axis, would displace the surface by 0.2 to 0.3 mm; 27
    # independent errors leave a mean of 0.2 standard deviations.
    row = found.prediction.value("depth", "pixel_std").value
    assert abs(found.prediction.value("depth", "bias").value) < 0.6 * row
    real, other = (each["image"].sel(s=0, t=0).values for each in (recording, copy))
    assert np.nanmedian(np.abs(real / recording.attrs["full_scale"] - other / copy.attrs["full_scale"])) < 0.01

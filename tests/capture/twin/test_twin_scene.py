"""Scenes of twins: they show what the capture shows, load as any scene, and are a base of designs."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth.capture import make_twin
from scenetruth.capture.twin import open_run
from tests.helpers.measured_twins import FOCAL_PX, MeasuredCapture, measure_scene, two_plates
from tests.helpers.nightly import nightly


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> MeasuredCapture:
    return measure_scene(tmp_path_factory.mktemp("measured"), two_plates())


@pytest.fixture(scope="module")
def twin(measured: MeasuredCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("twin") / "scene"
    made = make_twin(measured.capture, measured.run, place)
    assert sorted(made.motions) == ["surface_1", "surface_2"]
    assert set(made.motions.values()) <= {"static", "translation", "rigid"}
    assert made.sensor.origin == "dark frames and flat fields"
    return place


def rendered(folder: Path) -> st.Simulation:
    scene = st.load_scene(folder / "scene.yaml", overrides=["sensor=ideal"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        return st.simulate(scene)


@nightly
def test_the_twin_shows_the_images_of_the_capture(measured: MeasuredCapture, twin: Path) -> None:
    recording = st.open_store(measured.run / "recording.zarr")
    found = rendered(twin).recording
    for s in (-1, 0, 1):
        real = recording["image"].sel(s=s, t=0).values / recording.attrs["full_scale"]
        copy = found["image"].sel(s=s, t=0).values
        inside = np.abs(real - copy) < 0.05
        # Silhouettes are known to about a pixel; they are 4 x 45 of 12,288 pixels.
        assert inside.mean() > 0.94
        # The noise of the sensor at this level is 0.6 % of full scale.
        assert np.std((real - copy)[inside]) < 0.010
        gradients = [np.sqrt(np.mean(np.gradient(each, axis=1)[inside] ** 2)) for each in (real, copy)]
        noise = 0.006 / np.sqrt(2)
        assert gradients[1] == pytest.approx(np.sqrt(gradients[0] ** 2 - noise**2), rel=0.04)


def test_the_twin_has_the_surfaces_and_motions_of_the_capture(measured: MeasuredCapture, twin: Path) -> None:
    exact = st.open_store(measured.truth).sel(t=0)
    copy = rendered(twin).truth.sel(t=0)
    interior = (exact["boundary_distance"].values > 8) & (copy["boundary_distance"].values > 8)
    interior &= np.isfinite(exact["depth"].values + copy["depth"].values)
    depth = (copy["depth"] - exact["depth"]).values[interior]
    stated = st.open_store(measured.run / "estimate.refined.zarr")["depth_std"].sel(t=0).values[interior]
    assert np.sqrt(np.mean(depth**2)) < 1.5 * np.sqrt(np.nanmean(stated**2))
    plate = interior & (exact["object_id"].values == 1)
    for axis, tolerance in enumerate((0.01, 0.01, 0.1)):
        velocity = copy["velocity"].values[axis][plate]
        assert velocity == pytest.approx((0.2, 0.1, -0.8)[axis], abs=tolerance)


def test_the_scene_file_is_one_of_the_same_rig(measured: MeasuredCapture, twin: Path) -> None:
    scene = st.load_scene(twin / "scene.yaml")
    assert (scene.camera.width, scene.camera.height, scene.camera.focal_px) == (128, 96, FOCAL_PX)
    assert (scene.stage.positions, scene.frames.count, scene.frames.frame_interval_s) == (3, 3, 60)
    assert scene.estimate.method == "refined"
    names = {path.name for path in twin.iterdir()}
    assert names == {"scene.yaml", *(f"surface_{n}.{end}" for n in (1, 2) for end in ("ply", "png"))}


@nightly
def test_the_twin_is_a_base_of_a_design(twin: Path) -> None:
    spec = {
        "title": "Baseline of the measured rig",
        "scene": str(twin / "scene.yaml"),
        "method": "structure_tensor",
        "variables": {"stage.baseline_mm": {"from": 2, "to": 10, "log": True}},
        "constraints": [{"kind": "stage_travel", "max": 20}],
        "objectives": [{"quantity": "depth"}],
        "search": {"predictions": 16, "morris_trajectories": 0, "sobol": 0},
        "confirmation": {"rigs": 0},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        found = st.optimise(spec)
    assert found.to_dataframe().shape[0] > 0


def test_a_mesh_replaces_the_depth(measured: MeasuredCapture, twin: Path, tmp_path: Path) -> None:
    file = tmp_path / "wall.obj"
    corners = [(-120, -90, 700), (120, -90, 680), (120, 90, 680), (-120, 90, 700)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    file.write_text("\n".join([*lines, "f 1 2 3", "f 1 3 4", ""]), encoding="utf-8")
    made = make_twin(measured.capture, measured.run, tmp_path / "twin", mesh=file)
    truth = st.make_truth(made.scene).sel(t=0)
    x, z = truth["depth"].sel(y=48)["x"].values, truth["depth"].sel(y=48).values
    # On the plane, Z = 690 - X / 12 with X = (x - c_x) Z / f.
    assert z == pytest.approx(690 / (1 + (x - 63.5) / FOCAL_PX / 12), rel=1e-5)
    assert list(made.motions) == ["surface_1"]


def test_all_problems_are_reported_together(measured: MeasuredCapture, tmp_path: Path) -> None:
    plain = measured.capture.to_dict()
    plain["frames"]["count"] = 2
    plain["camera"]["width"] = 120
    other = st.capture.Capture.from_dict(plain, folder=measured.capture.folder)
    with pytest.raises(st.CaptureError) as caught:
        make_twin(other, measured.run, tmp_path / "twin")
    # Images of another size are found first, by their headers.
    assert caught.value.problems
    with pytest.raises(st.CaptureError, match=r"has no recording(.|\n)*has no estimate"):
        open_run(tmp_path)
    with pytest.raises(st.CaptureError, match=r"has no estimate in .*; it has refined"):
        make_twin(measured.capture, measured.run, tmp_path / "twin", method="structure_tensor")
    for name in ("nothing.obj", "wrong.obj"):
        (tmp_path / "wrong.obj").write_text("v 0 0\n")
        with pytest.raises(st.SceneError, match="mesh: "):
            make_twin(measured.capture, measured.run, tmp_path / "twin", mesh=tmp_path / name)
    assert not (tmp_path / "twin").exists()


def test_a_run_of_another_capture_is_rejected(measured: MeasuredCapture, tmp_path: Path) -> None:
    plain = measured.capture.to_dict()
    plain["frames"]["count"] = 1
    plain["stage"]["positions"] = 1
    plain["files"]["images"] = "images/s+0_t+0.tif"
    other = st.capture.Capture.from_dict(plain, folder=measured.capture.folder)
    with pytest.raises(st.CaptureError) as caught:
        make_twin(other, measured.run, tmp_path / "twin")
    assert [problem.path for problem in caught.value.problems] == ["stage.positions", "frames.count"]


@nightly
def test_an_existing_twin_is_replaced_on_demand_and_foreign_files_are_kept(
    measured: MeasuredCapture, twin: Path, tmp_path: Path
) -> None:
    place = tmp_path / "twin"
    shutil.copytree(twin, place)
    (place / "notes.md").write_text("mine")
    with pytest.raises(st.OutputExistsError):
        make_twin(measured.capture, measured.run, place)
    make_twin(measured.capture, measured.run, place, overwrite=True, seed=3)
    assert (place / "notes.md").read_text() == "mine"
    assert st.load_scene(place / "scene.yaml").seed == 3
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.png").write_bytes(b"")
    with pytest.raises(st.OutputExistsError, match="did not write"):
        make_twin(measured.capture, measured.run, tmp_path / "other", overwrite=True)

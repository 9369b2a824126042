"""A scene through all stages: what is finished stays, whatever happens to the rest, and whenever a run is killed."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import Method, registry
from scenetruth.pipeline import PipelineRunner, RunDirectory, run_scene
from tests.helpers.killed_runs import Killer
from tests.helpers.nightly import by_day, by_night, nightly
from tests.helpers.scenes import FIGURES, SMALL_CUBE, cube

# Figures are drawn in `tests.scoring.figures`, and those of a whole run by the fixture that tests share.
pytestmark = pytest.mark.usefixtures("undrawn_figures")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_methods_stand_side_by_side(finished: Path) -> None:
    plain = {"estimate.zarr", "score.json", "score.csv", "report.html", "figures"}
    other = {
        "estimate.opencv_flow.zarr",
        "score.opencv_flow.json",
        "score.opencv_flow.csv",
        "report.opencv_flow.html",
        "figures.opencv_flow",
    }
    assert names(finished) == {"scene.yaml", "recording.zarr", "truth.zarr"} | plain | other
    run = st.RunDirectory(finished)
    assert run.estimated() == ["structure_tensor", "opencv_flow"]
    score = st.Score.from_json(run.paths("opencv_flow").score_json.read_text())
    assert {"flow_x", "flow_y"} <= set(score.regions["all"])
    assert not {"depth", "velocity_z"} & set(score.regions["all"])


def test_stages_can_be_taken_up_later(finished: Path, tmp_path: Path) -> None:
    scene = cube(**SMALL_CUBE)
    run_scene(scene, output=tmp_path / "x", stages=("render",))
    results = run_scene(scene, output=tmp_path / "x", stages=("estimate", "score"))
    again = st.load_store(tmp_path / "x" / "estimate.zarr", kind="estimate")
    xr.testing.assert_identical(again, st.load_store(finished / "estimate.zarr", kind="estimate"))
    assert results.scores["structure_tensor"].metadata["recording_hash"] == again.attrs["recording_hash"]
    with pytest.raises(st.MismatchError, match=r"recording\.zarr: belongs to another scene"):
        run_scene(cube(**SMALL_CUBE, seed=9), output=tmp_path / "x", stages=("estimate",), overwrite=True)


def test_what_cannot_be_is_found_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(st.SceneError, match=r"frames\.count: 'opencv_flow' needs 2 frames"):
        run_scene(cube(**{**SMALL_CUBE, "frames": {"count": 1}}), output=tmp_path / "x", methods=("opencv_flow",))
    with pytest.raises(st.EstimateError, match="no such method"):
        run_scene(cube(**SMALL_CUBE), output=tmp_path / "x", methods=("guess",))
    with pytest.raises(st.ArgumentError, match="must be some of render, estimate, score, report"):
        run_scene(cube(**SMALL_CUBE), output=tmp_path / "x", stages=("rendre",))  # type: ignore[arg-type]
    assert not (tmp_path / "x").exists()


class Broken(Method):
    name = "broken"

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Any) -> xr.Dataset:
        message = "out of luck"
        raise ArithmeticError(message)


class Flat(Method):
    name = "flat"

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Any) -> xr.Dataset:
        return st.make_estimate(recording=recording, disparity=np.full(recording["image"].shape[1:], 6.0))


class Endless(Method):
    name = "endless"

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Any) -> xr.Dataset:
        raise KeyboardInterrupt


@pytest.fixture
def with_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = registry.list_methods()
    entries.append(registry.MethodEntry("broken", "test", "", Broken))
    entries.append(registry.MethodEntry("flat", "test", "", Flat))
    entries.append(registry.MethodEntry("endless", "test", "", Endless))
    monkeypatch.setattr(registry, "list_methods", lambda: entries)


@pytest.mark.usefixtures("with_methods")
def test_a_method_that_fails_keeps_no_other_from_its_work(tmp_path: Path) -> None:
    results = run_scene(
        cube(**SMALL_CUBE),
        output=tmp_path / "x",
        methods=("broken", "structure_tensor"),
        stages=("render", "estimate", "score"),
    )
    assert set(results.scores) == {"structure_tensor"}
    assert "method 'broken': failed: ArithmeticError: out of luck" in str(results.failures["broken"])
    assert names(tmp_path / "x") == {
        "scene.yaml",
        "recording.zarr",
        "truth.zarr",
        "estimate.zarr",
        "score.json",
        "score.csv",
        ".unfinished",
    }


@pytest.mark.usefixtures("with_methods")
def test_an_interrupt_keeps_what_is_finished(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_scene(cube(**SMALL_CUBE), output=tmp_path / "x", methods=("flat", "endless"), figures=["image"])
    assert {"recording.zarr", "truth.zarr", "estimate.zarr", "score.json", "report.html"} <= names(tmp_path / "x")
    assert not [name for name in names(tmp_path / "x") if "endless" in name or "partial" in name]


@pytest.mark.usefixtures("with_methods")
def test_an_interrupted_run_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, messages: list[str]
) -> None:
    folder = tmp_path / "x"
    asked: dict[str, Any] = {"methods": ("flat", "endless"), "figures": ["image"]}
    with pytest.raises(KeyboardInterrupt):
        run_scene(cube(**SMALL_CUBE), output=folder, **asked)
    # Another question is not gone on with.
    for other in ({"methods": ("flat",)}, {"truth_content": "complete"}, {"figures": ["depth"]}):
        with pytest.raises(st.OutputExistsError):
            run_scene(cube(**SMALL_CUBE), output=folder, **{**asked, **other})
    with pytest.raises(st.OutputExistsError):
        run_scene(cube(**SMALL_CUBE, seed=9), output=folder, **asked)

    monkeypatch.setattr(Endless, "estimate", Flat.estimate)
    kept = ("recording.zarr", "truth.zarr", "estimate.zarr", "report.html")
    before = {name: (folder / name).stat().st_ino for name in kept}
    messages.clear()
    results = run_scene(cube(**SMALL_CUBE), output=folder, **asked)
    assert messages[0] == "resuming the interrupted run: images and truth exist"
    assert {name: (folder / name).stat().st_ino for name in kept} == before
    assert set(results.scores) == {"flat", "endless"}
    # Nothing is left to go on with.
    assert ".unfinished" not in names(folder)
    with pytest.raises(st.OutputExistsError):
        run_scene(cube(**SMALL_CUBE), output=folder, **asked)


@pytest.mark.usefixtures("with_methods")
def test_a_stage_on_its_own_ends_what_could_be_gone_on_with(tmp_path: Path) -> None:
    folder = tmp_path / "x"
    with pytest.raises(KeyboardInterrupt):
        run_scene(cube(**SMALL_CUBE), output=folder, methods=("endless",))
    assert ".unfinished" in names(folder)
    run_scene(cube(**SMALL_CUBE), output=folder, stages=("estimate",), methods=("flat",))
    assert ".unfinished" not in names(folder)
    with pytest.raises(st.OutputExistsError):
        run_scene(cube(**SMALL_CUBE), output=folder, methods=("endless",))


def test_a_score_of_another_estimate_is_not_reported(finished: Path, tmp_path: Path) -> None:
    scene = cube(**SMALL_CUBE)
    shutil.copytree(finished, tmp_path / "x")
    (tmp_path / "x" / "report.html").unlink()
    changed = scene.model_copy(
        update={"estimate": st.Scene.from_dict(scene.to_dict() | {"estimate": {"window_sigma_px": 4.0}}).estimate}
    )
    run_scene(changed, output=tmp_path / "x", stages=("estimate",), overwrite=True)
    results = run_scene(changed, output=tmp_path / "x", stages=("report",), overwrite=True)
    assert "belongs to another estimate" in str(results.failures["structure_tensor"])
    assert not (tmp_path / "x" / "report.html").exists()


def test_real_images_are_reported_without_a_truth(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (3, 5, 60, 80), dtype=np.uint8)
    st.save_store(st.make_recording(images, 700.0, 5.0), tmp_path / "recording.zarr")
    runner = PipelineRunner(st.RunDirectory(tmp_path))
    runner.estimate(runner.choice(None, ["estimate.working_point_px=0"]))
    runner.report("structure_tensor", ["image"])
    assert {"report.html", "figures"} <= names(tmp_path)
    with pytest.raises(st.StoreError, match=r"truth\.zarr: no such store"):
        runner.score("structure_tensor", runner.score_settings())


def test_a_report_that_is_as_new_is_left_alone(finished: Path, tmp_path: Path, messages: list[str]) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)

    def report(**options: Any) -> bool:
        """Report, and tell whether anything was drawn."""
        before = (run / "report.html").stat().st_mtime_ns
        with PipelineRunner(RunDirectory(run), options.pop("overwrite", False)) as runner:
            runner.report("structure_tensor", **options)
        return (run / "report.html").stat().st_mtime_ns != before

    assert not report(figures=FIGURES)
    assert messages == [f"{run / 'report.html'} is up to date"]
    # Another choice of figures, or another score, makes another page, which replaces the old one only if allowed.
    with pytest.raises(st.OutputExistsError):
        report(figures=["depth"])
    assert report(figures=["depth"], overwrite=True)
    assert names(run / "figures") == {"depth.png"}
    assert not report(figures=["depth"])
    (run / "figures" / "notes.txt").write_text("mine")
    with pytest.raises(st.OutputExistsError, match=r"not written by scenetruth \(notes\.txt\)"):
        report(overwrite=True)


def test_figures_may_be_chosen_and_are_checked_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(st.ArgumentError, match="figures: must be some of image, surface"):
        run_scene(cube(**SMALL_CUBE), output=tmp_path / "x", figures=["dept"])
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(("method", "seen"), [("structure_tensor", False), *by_night(("refined", True))])
def test_growth_that_is_smaller_than_its_error_is_told(
    tmp_path: Path, method: str, seen: bool, messages: list[str]
) -> None:
    # On a surface that faces the camera, the structure tensor takes growth for motion towards it.
    wall: dict[str, Any] = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [120, 120]}}
    wall |= {"pose": {"position_mm": [0, 0, 100]}, "texture": {"kind": "noise", "wavelength_mm": [5, 20]}}
    wall |= {"deformation": [{"kind": "growth", "rate_per_hour": 0.01}]}
    changes: dict[str, Any] = {"camera": {"width": 96, "height": 80, "focal_length_px": 96}, "objects": [wall]}
    changes |= {"stage": {"positions": 5, "baseline_mm": 1}, "sensor": {"bit_depth": None, "noise_std": 0.01}}
    changes |= {"frames": {"count": 9, "frame_interval_s": 7200}, "score": {"interior_margin_px": 2}}
    stages: Any = ("render", "estimate", "score")
    run_scene(cube(**changes), output=tmp_path / "x", methods=(method,), stages=stages)
    notes = [line for line in messages if line.startswith(f"growth is not resolved by '{method}'")]
    assert bool(notes) is not seen
    for note in notes:
        assert note.endswith("error is 1 %/h, the RMS growth rate 1 %/h; --method refined is more precise")


@by_day
def test_a_run_that_is_killed(tmp_path: Path) -> None:
    with Killer(tmp_path, seed=0) as killer:
        killer.kill_once(0, earlier=True)


@nightly
def test_two_hundred_kills(tmp_path: Path) -> None:
    come: Counter[str] = Counter()
    with Killer(tmp_path, seed=2) as killer:
        for number in range(180):
            come[killer.kill_once(number, earlier=number % 2 == 1)] += 1
            shutil.rmtree(tmp_path / f"place-{number}")
    with Killer(tmp_path, seed=3, stages=("render", "estimate", "score", "report")) as killer:
        for number in range(20):
            come[killer.kill_once(number, earlier=number % 2 == 1)] += 1
            shutil.rmtree(tmp_path / f"place-{number}")
    print(f"how far 200 runs had come when they were killed: {dict(come)}")
    assert len(come) > 3


@nightly
def test_fifty_pairs_of_runs(tmp_path: Path) -> None:
    with Killer(tmp_path, seed=4) as killer, Killer(tmp_path, seed=5) as other:
        for number in range(50):
            killer.two_at_once(other, number, kill=number % 2 == 1)
            shutil.rmtree(tmp_path / f"pair-{number}")

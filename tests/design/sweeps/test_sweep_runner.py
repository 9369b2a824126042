"""Sweeps of a small scene: against theory, against single simulations, interrupted and gone on."""

from __future__ import annotations

import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml

import scenetruth as st
from scenetruth.design.sweeps import Sweep, bound_window_from_method, build_plan, sweep
from scenetruth.errors import ArgumentError, EstimateError, OutputExistsError
from scenetruth.estimators.method_specs import MethodSpec, parse_methods
from tests.helpers.nightly import nightly
from tests.helpers.sweep_scenes import DEPTH_MM, METHOD, failing, nearest, scene

# Plots are drawn in `tests.design.sweeps.test_sweep_report`.
pytestmark = pytest.mark.usefixtures("undrawn_figures")

NOISE = "sensor.noise_std"
BASELINE = "stage.baseline_mm"
# Windows of 3 px are independent at 4π 3² px each: 1300 px that are told, with two seeds, make 23 of them, whose rms
# scatters by 15 %. Points have the same noise, and differ by less.
SCATTER = 0.15


@pytest.fixture(scope="module")
def found() -> Sweep:
    return sweep(scene(), {BASELINE: [1, 2], NOISE: [0.005, 0.01]}, methods=METHOD, seeds=2)


def rms(found: Sweep, quantity: str, baseline: float, noise: float, **which: Any) -> float:
    return found.value(quantity, at={BASELINE: baseline, NOISE: noise}, **which).value


def test_depth_errs_inversely_to_the_baseline_and_in_proportion_to_noise(found: Sweep) -> None:
    for noise in (0.005, 0.01):
        assert rms(found, "depth", 1, noise) / rms(found, "depth", 2, noise) == pytest.approx(2, rel=SCATTER)
    for baseline in (1, 2):
        for quantity in ("depth", "disparity", "flow_x"):
            # The noise is the same but for its size, and what is left is of second order: a few per cent.
            ratio = rms(found, quantity, baseline, 0.01) / rms(found, quantity, baseline, 0.005)
            assert ratio == pytest.approx(2, rel=0.06)


def test_nothing_goes_below_the_bound_and_the_structure_tensor_is_near_it(found: Sweep) -> None:
    for quantity in ("depth", "disparity", "velocity_x", "velocity_y", "flow_x"):
        for baseline in (1, 2):
            bound = rms(found, quantity, baseline, 0.01, method="bound")
            # Derivative filters and three frames cost up to a third of the noise more than the bound.
            assert 1 - SCATTER < rms(found, quantity, baseline, 0.01) / bound < 1.33 + SCATTER
    assert found.value("depth", "precision_std", method="bound").value == found.value("depth", method="bound").value
    median = found.value("depth", "median_abs_error", method="bound").value
    assert median < found.value("depth", method="bound").value


def test_noise_is_the_same_at_every_point() -> None:
    plan = build_plan(
        scene(sensor={"noise_std": 0.01, "bit_depth": None}), {BASELINE: [1, 2], NOISE: [0.005, 0.01]}, seeds=2
    )
    noises = []
    for number in range(0, len(plan), 2):
        recording, _ = st.simulate(plan.scene(number), save_radiance=True)
        full_scale = recording.attrs["full_scale"]
        noise = recording["image"].values / full_scale - recording["radiance"].values
        noises.append(noise / plan.scene(number).sensor.noise_std)  # type: ignore[union-attr]
    for other in noises[1:]:
        # Images are float32, and noise is at least 0.005 of full scale.
        assert other == pytest.approx(noises[0], abs=1e-4)


def test_figures_are_those_of_a_single_simulation(found: Sweep) -> None:
    plain = scene(stage={"positions": 3, "baseline_mm": 2}, seed=6)
    recording, truth = st.simulate(st.Scene.from_dict(plain))
    errors = {}
    for seed in (5, 6):
        recording, truth = st.simulate(st.Scene.from_dict(plain | {"seed": seed}))
        estimate = st.estimate(recording, "structure_tensor", window_sigma_px=3, window_taps_px=13)
        score = st.score(estimate, truth, settings={"interior_margin_px": 0})
        for name in ("rmse", "bias", "median_abs_error", "density"):
            row = found.value("velocity_z", name, at={BASELINE: 2, NOISE: 0.01}, region="all", seed=seed)
            assert row.value == score.regions["all"]["velocity_z"][name]
        error = (estimate["depth"] - truth["depth"].sel(t=[0])).values
        errors[seed] = np.where(estimate["status_disparity"] == 2, error, np.nan)
    both = found.value("depth", "precision_std", at={BASELINE: 2, NOISE: 0.01}, region="all").value
    # Between two numbers, the standard deviation is their difference over √2.
    assert both == pytest.approx(float(np.sqrt(np.nanmean(np.square(errors[5] - errors[6]) / 2))), rel=1e-4)
    pooled = found.value("depth", at={BASELINE: 2, NOISE: 0.01}, region="all")
    each = [found.value("depth", at={BASELINE: 2, NOISE: 0.01}, region="all", seed=seed).value for seed in (5, 6)]
    assert pooled.value == pytest.approx(math.hypot(*each) / math.sqrt(2))
    assert pooled.ci_low < min(each) < max(each) < pooled.ci_high


def test_the_table_is_tidy(found: Sweep) -> None:
    frame = found.to_dataframe()
    assert list(frame.columns[:5]) == [BASELINE, NOISE, "scene", "method", "seed"]
    keys = ["scene", "method", "seed", "region", "quantity", "statistic", BASELINE, NOISE]
    assert not frame.duplicated(keys).any()
    assert set(frame["statistic"]) == {"rmse", "bias", "precision_std", "median_abs_error", "density"}
    assert set(frame["region"]) == {"all", "interior"}
    assert np.isfinite(frame["value"]).all()
    told = frame[(frame["quantity"] == "depth") & (frame["statistic"] == "rmse") & frame["seed"].isna()]
    told = told[(told["region"] == "interior") & (told["method"] != "bound")]
    best = found.best("depth")
    assert best.value == told["value"].min()
    assert dict(best.values) == {BASELINE: 2, NOISE: 0.005}
    with pytest.raises(st.ArgumentError, match="no rmse in region"):
        found.best("slope_x")
    with pytest.raises(st.ArgumentError, match=f"{BASELINE} = 7"):
        found.value("depth", at={BASELINE: 7})


@nightly
def test_it_goes_on_where_it_was(tmp_path: Path, messages: list[str]) -> None:
    told = messages
    options: dict[str, Any] = {"seeds": 2}
    calm = sweep(scene(), {BASELINE: [2, 3]}, methods=nearest, output=tmp_path / "calm", **options)
    points = tmp_path / "calm" / "points"
    before = {path.name: path.read_bytes() for path in points.iterdir()}
    assert len(before) == 8
    # As if it had been killed: files are missing, and one is half written beside its place.
    figures = sorted(points.glob("*.json"))
    figures[0].unlink()
    figures[1].with_suffix(".npz").unlink()
    (points / f".{figures[0].name}.partial-0-0-0").write_text("{")
    again = sweep(scene(), {BASELINE: [2, 3]}, methods=nearest, output=tmp_path / "calm", **options)
    assert "4 simulations, 2 of them to run" in told[-1]
    assert {path.name: path.read_bytes() for path in points.iterdir() if path.suffix == ".json"} == {
        name: content for name, content in before.items() if name.endswith(".json")
    }
    pd.testing.assert_frame_equal(again.to_dataframe(), calm.to_dataframe())
    # More values, and only these are made.
    more = sweep(scene(), {BASELINE: [2, 2.5, 3]}, methods=nearest, output=tmp_path / "calm", **options)
    assert "6 simulations, 2 of them to run" in told[-1]
    kept = pd.read_csv(tmp_path / "calm" / "results.csv")
    made = more.to_dataframe()
    # Empty texts and missing values are the same in CSV; numbers are read within some units in the last place.
    made = made.mask(made == "").convert_dtypes()
    pd.testing.assert_frame_equal(kept.convert_dtypes(), made, check_dtype=False, rtol=1e-14)
    assert (tmp_path / "calm" / "plots" / "depth_rmse.png").exists()


@nightly
def test_what_failed_or_has_changed_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, messages: list[str]
) -> None:
    told = messages
    options: dict[str, Any] = {"seeds": 1}
    (tmp_path / "wall_of_mine.py").write_text("def f(recording):\n    return {'dpeth': 1}\n")
    monkeypatch.chdir(tmp_path)

    def run() -> Sweep:
        sys.modules.pop("wall_of_mine", None)
        return sweep(scene(), {BASELINE: [2, 3]}, methods="wall_of_mine:f", output=tmp_path / "out", **options)

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert len(run().failures) == 2
    assert len(run().failures) == 2
    assert "2 simulations, 2 of them to run" in told[-1]
    for depth_mm in (500, 510):
        code = f"def f(recording):\n    return {{'depth': 0.0 * recording.image[0].values + {depth_mm}}}\n"
        (tmp_path / "wall_of_mine.py").write_text(code)
        found = run()
        assert found.value("depth", "bias").value == pytest.approx(depth_mm - DEPTH_MM, abs=0.2)
        assert "2 simulations, 2 of them to run" in told[-1]
    run()
    assert told[-1].endswith("2 simulations, 0 of them to run, 2 results reused")
    sys.modules.pop("wall_of_mine")


def test_scenes_and_methods_are_factors_and_what_fails_is_told() -> None:
    other = scene(objects=[scene()["objects"][0] | {"pose": {"position_mm": [0, 0, 510]}}])
    methods: list[Any] = [nearest, MethodSpec(METHOD.method, METHOD.settings, "mine"), failing]
    found = sweep([scene(), other], {BASELINE: [2, 3]}, methods=methods, seeds=1)
    assert found.methods == ["nearest", "mine", "failing"]
    # The wall is 10 mm farther than the method knows.
    assert found.value("depth", "bias", method="nearest", scene="scene 1").value == pytest.approx(0, abs=1e-6)
    assert found.value("depth", "bias", method="nearest", scene="scene 2").value == pytest.approx(-10)
    assert found.value("depth", method="bound of mine", scene="scene 2").value > 0
    assert len(found.failures) == 4
    assert "scene 1, stage.baseline_mm = 2, seed 5: failing" in found.failures[0]
    assert "no idea" in found.failures[0]
    with pytest.raises(st.ArgumentError):
        found.value("depth", "precision_std", method="mine")


def test_a_scenes_own_settings_vary_and_what_has_no_noise_has_no_bound() -> None:
    plain = scene(sensor="ideal", estimate={"window_taps_px": 13})
    found = sweep(plain, {"estimate.window_sigma_px": [2, 3]}, seeds=1)
    assert found.methods == ["structure_tensor"]
    errors = [found.value("disparity", at={"estimate.window_sigma_px": sigma}).value for sigma in (2, 3)]
    assert errors[0] != errors[1]
    assert not any(row.is_bound for row in found.rows)
    assert "no bound: noise_std: is zero" in found.notes[0]
    # A wall without motion and light of its own: nothing of the light matters.
    idle = sweep(scene(), {"render.platform": ["auto", "egl"]}, methods=nearest, seeds=1)
    assert idle.notes == ["render.platform has no effect on any statistic"]


def test_a_method_that_gives_nothing_leaves_a_page_that_says_why(tmp_path: Path) -> None:
    found = sweep(scene(), {BASELINE: [2, 3]}, methods=failing, output=tmp_path / "out", seeds=1)
    assert found.rows == []
    assert len(found.failures) == 2
    assert "no idea" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    # A wall of 30 px has no pixels 20 px from its outline.
    wall = scene()["objects"][0] | {"mesh": {"kind": "plane", "size_mm": [30, 30]}}
    plain = scene(objects=[wall], score={"interior_margin_px": 20})
    edge = sweep(plain, {BASELINE: [2, 3]}, methods=nearest, output=tmp_path / "out", seeds=1)
    assert (tmp_path / "out" / "plots" / "depth_rmse.png").exists()
    # It moves by 0.1 mm per frame over three frames, and the method does not know it.
    assert edge.best("depth", region="all").value == pytest.approx(0.1 * math.sqrt(2 / 3), rel=1e-6)
    with pytest.raises(st.ArgumentError):
        edge.best("depth")


def test_the_bound_is_that_of_each_methods_window() -> None:
    windows = [
        bound_window_from_method(one)
        for one in parse_methods(["structure_tensor", "refined[motion: rigid]", "refined", nearest])
    ]
    told = [(one.sigma_px, one.surface, one.motion, one.brightness) for one in windows]
    assert told == [
        (6.0, "constant", "translation", "fixed"),
        (6.0, "plane", "rigid", "per_image"),
        (6.0, "plane", "auto", "per_image"),
        (6.0, "constant", "translation", "fixed"),
    ]


def stretching(recording: xr.Dataset) -> xr.Dataset:
    """Know that the wall grows along X alone, by 2 % per frame."""
    shape = recording["image"].isel(s=0).shape
    found = st.make_estimate(recording=recording, depth=np.full(shape, DEPTH_MM), flow=np.zeros((2, *shape)))
    growth = (("principal", "t", "y", "x"), np.stack([np.full(shape, 0.02), np.zeros(shape)]), {"units": "1/frame"})
    return found.assign_coords(principal=[1, 2]).assign(principal_growth_rates=growth)


@nightly
def test_what_only_a_complete_truth_tells_is_scored() -> None:
    wall = scene()["objects"][0] | {"motion": [], "deformation": [{"kind": "growth", "rate_per_hour": 18.0}]}
    wall["deformation"][0] |= {"along_share": 1.0}
    plain = scene(objects=[wall], frames={"count": 3, "frame_interval_s": 4.0})
    found = sweep(plain, {BASELINE: [2, 3]}, methods=[stretching, nearest], seeds=2)
    # 18 per hour are 2 % per frame at rest, in percent per hour 1800; what has grown does so by 2 % less of itself.
    for quantity in ("growth_principal_1", "growth_principal_2"):
        assert found.value(quantity, "rmse", at={BASELINE: 2}, method="stretching").value < 0.03 * 1800
    with pytest.raises(st.ArgumentError):
        found.value("growth_principal_1", method="nearest")


def test_what_cannot_be_made_is_told_before_any_work(tmp_path: Path) -> None:
    done: list[str] = []
    with pytest.raises(ArgumentError) as error:
        sweep(
            scene(),
            {"objects.0.pose.position_mm": [[0, 0, 500], [900, 0, 500]], "camera.width": [64, 20]},
            methods="structure_tensor",
            progress=lambda what, *_: done.append(what),
        )
    assert "camera.width = 64" in str(error.value)
    assert set(done) == {"checks"}
    with pytest.raises(EstimateError, match="no_such"):
        sweep(scene(), {BASELINE: [1, 2]}, methods="no_such")
    with pytest.raises(EstimateError, match="another process"):
        sweep(scene(), {BASELINE: [1, 2]}, methods=lambda recording: nearest(recording), workers=2)
    with pytest.raises(EstimateError, match="use another label"):
        sweep(scene(), {BASELINE: [1, 2]}, methods=MethodSpec("structure_tensor", label="bound"))
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(OutputExistsError, match="not a directory of a sweep"):
        sweep(scene(), {BASELINE: [1, 2]}, methods=nearest, output=tmp_path)


@nightly
def test_processes_find_the_same() -> None:
    here, there = (sweep(scene(), {BASELINE: [1, 2]}, methods=METHOD, seeds=2, workers=workers) for workers in (1, 2))
    pd.testing.assert_frame_equal(here.to_dataframe(), there.to_dataframe())


@nightly
def test_a_killed_sweep_goes_on_to_the_same_figures(tmp_path: Path) -> None:
    file = tmp_path / "wall.yaml"
    file.write_text(yaml.safe_dump(scene()))
    words = [sys.executable, "-m", "scenetruth", "design", "sweep", str(file), "--vary", f"{BASELINE}=1..4:7"]
    words += ["--method", METHOD.spelled, "--workers", "2", "-o"]
    generator = random.Random(1)
    for _ in range(4):
        run = subprocess.Popen([*words, str(tmp_path / "killed")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(generator.uniform(6.0, 16.0))
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
    for name in ("killed", "calm"):
        subprocess.run([*words, str(tmp_path / name)], check=True, capture_output=True)
    killed, calm = (pd.read_csv(tmp_path / name / "results.csv") for name in ("killed", "calm"))
    pd.testing.assert_frame_equal(killed, calm)
    points = tmp_path / "killed" / "points"
    assert [path.name for path in points.iterdir() if path.suffix not in (".json", ".npz")] == []
    assert {path.name for path in points.iterdir()} == {path.name for path in (tmp_path / "calm" / "points").iterdir()}

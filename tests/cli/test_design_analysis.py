"""The commands that predict, budget and sweep, as a user runs them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import yaml

from tests.helpers.budget_scenes import laboratory
from tests.helpers.command_line import names, scenetruth
from tests.helpers.nightly import nightly
from tests.helpers.prediction_scenes import wall
from tests.helpers.scenes import SCENES
from tests.helpers.sweep_scenes import METHOD, scene


@pytest.mark.usefixtures("undrawn_figures")
def test_the_command(tmp_path: Path) -> None:
    scene = laboratory({"sensor": {"noise_std": 0.004, "bit_depth": 8}}, everything=False)
    file = tmp_path / "small.yaml"
    file.write_text(yaml.safe_dump(scene.to_dict()))
    few = ("--seeds", "1", "--workers", "1", "--simulated-share", "0", "--calibration", "perfect")
    done = scenetruth("design", "budget", file, "-o", tmp_path / "b", *few, "--focal-length-percent", "0.1")
    assert done.returncode == 0, done.stderr
    assert "Depth: " in done.stdout
    assert "focal length" in done.stdout
    assert "baseline" not in done.stdout
    # Rounding errors of zero contributions are zero, as in the page.
    assert "× 10⁻¹" not in done.stdout
    assert (tmp_path / "b" / "waterfall.png").exists()
    wrong = scenetruth("design", "budget", file, *few, "--region", "nowhere")
    assert wrong.returncode == 2
    assert "interior" in wrong.stderr
    refused = scenetruth("design", "budget", file, "--set", "camera.width=nothing")
    assert refused.returncode == 2
    assert "camera.width" in refused.stderr


def file_of(folder: Path, **changes: object) -> Path:
    (folder / "wall.yaml").write_text(yaml.safe_dump(wall(**changes)))
    return folder / "wall.yaml"


def test_the_table_has_what_there_is_beside_what_can_be_known(tmp_path: Path) -> None:
    output = tmp_path / "out"
    done = scenetruth(
        "design", "predict", file_of(tmp_path), "--method", "refined", "--model", "maps", "-o", str(output)
    )
    assert done.returncode == 0, done.stderr
    for words in ("Depth", "Velocity in Z", "precision", "ratio", "grey-value noise", "5 positions, 5 frames"):
        assert words in done.stdout
    table = pd.read_csv(output / "prediction.csv")
    assert set(table["model"]) == {"maps"}
    assert (output / "prediction.png").stat().st_size > 10_000


def test_what_is_wrong_ends_it_with_a_message(tmp_path: Path) -> None:
    done = scenetruth(
        "design", "predict", file_of(tmp_path), "--method", "opencv_flow", "--setting", "window_sigma_px=0"
    )
    assert done.returncode == 2
    assert "method: precision can be predicted for refined, structure_tensor only" in done.stderr
    assert "window_sigma_px" in done.stderr


def test_check_tells_precision_motion_and_their_ratio() -> None:
    done = scenetruth("check", SCENES / "cube.yaml")
    assert done.returncode == 0, done.stderr
    assert "predicted precision per pixel, structure_tensor" in done.stdout
    assert "'cube': Depth" in done.stdout
    assert "'cube': Velocity in Z" in done.stdout
    assert "precision: median over each object, with textures by formula; includes image noise" in done.stdout
    assert done.stdout.rstrip().endswith("the scene is valid")


def test_check_warns_of_growth_that_is_lost_in_noise() -> None:
    done = scenetruth("check", SCENES / "leaf.yaml", "--set", "frames.frame_interval_s=6")
    assert done.returncode == 0, done.stderr
    assert "'leaf': Growth rate, refined" in done.stdout
    assert "growth of 'leaf' is" in " ".join(done.stderr.split())
    assert "raise frames.frame_interval_s to" in " ".join(done.stderr.split())


def test_check_says_why_nothing_is_predicted() -> None:
    done = scenetruth("check", SCENES / "plaid.yaml")
    assert done.returncode == 0, done.stderr
    assert "precision is not predicted: sensor: has no noise" in done.stdout


NEAREST = "tests.helpers.sweep_scenes:nearest"
RESULTS = {"index.html", "results.csv", "sweep.json", "plots", "points"}


@pytest.mark.usefixtures("undrawn_figures")
def test_a_sweep_is_made_and_goes_on(tmp_path: Path) -> None:
    file, out = tmp_path / "wall.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(scene()))
    words: list[str | Path] = ["design", "sweep", file, "--vary", "stage.baseline_mm=1..2:2"]
    words += ["--method", f"near={NEAREST}", "--seeds", "7,8", "--set", "camera.width=48", "--workers", "1", "-o", out]
    done = scenetruth(*words)
    assert done.returncode == 0, done.stderr
    assert "2 points with 2 seeds: 4 simulations, 4 of them to run" in done.stderr
    assert "smallest RMSE of each quantity, region interior" in done.stdout
    assert "baseline 1 mm" in done.stdout
    assert {name for name in names(out) if not name.startswith(".")} == RESULTS
    assert "4 simulations, 0 of them to run" in scenetruth(*words).stderr
    frame = pd.read_csv(out / "results.csv")
    assert set(frame["scene"]) == {"wall"}
    assert set(frame["method"]) == {"near", "bound"}
    assert set(frame["seed"].dropna()) == {7, 8}
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "--vary stage.baseline_mm=1..2:2 --method" in page
    assert "--set camera.width=48 --seeds 7,8 -o again" in page


def test_what_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    file = tmp_path / "wall.yaml"
    file.write_text(yaml.safe_dump(scene()))
    done = scenetruth("design", "sweep", file, "--vary", "stage.baseline_mm", "--seeds", "few")
    assert done.returncode == 2
    assert "--output" in done.stderr
    given = ("--seeds", "few", "-o", tmp_path / "out")
    done = scenetruth("design", "sweep", file, "--vary", "stage.baseline_mm", *given)
    assert done.returncode == 2
    assert done.stderr.startswith("error: 2 problems with the arguments of a sweep")
    for told in ("--vary: must have the form PATH=VALUES", "--seeds: must be a number"):
        assert told in done.stderr
    done = scenetruth("design", "sweep", file, "--vary", "stage.positons=3,5", "-o", tmp_path / "out")
    assert done.returncode == 2
    assert "did you mean 'positions'?" in done.stderr
    assert not (tmp_path / "out").exists()


@nightly
def test_a_method_of_the_house_in_processes(tmp_path: Path) -> None:
    file = tmp_path / "wall.yaml"
    file.write_text(yaml.safe_dump(scene()))
    words = (
        "design",
        "sweep",
        file,
        "--vary",
        "stage.baseline_mm=1,2",
        "--method",
        METHOD.spelled,
        "-o",
        tmp_path / "out",
    )
    done = scenetruth(*words, "--workers", "2")
    assert done.returncode == 0, done.stderr
    frame = pd.read_csv(tmp_path / "out" / "results.csv")
    assert (
        len(frame[frame["seed"].isna() & (frame["statistic"] == "precision_std") & (frame["quantity"] == "depth")]) == 8
    )

"""The command that sweeps."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import yaml

from tests.cli.calling import names, scenetruth
from tests.design.sweep.small import METHOD, scene
from tests.nightly import nightly

NEAREST = "tests.design.sweep.small:nearest"
RESULTS = {"index.html", "results.parquet", "results.csv", "sweep.json", "plots", "points"}


def test_a_sweep_is_made_and_goes_on(tmp_path: Path) -> None:
    file, out = tmp_path / "wall.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(scene()))
    words: list[str | Path] = ["design", "sweep", file, "--vary", "stage.baseline_mm=1..2:2"]
    words += ["--method", f"near={NEAREST}", "--seeds", "7,8", "--set", "camera.width=48", "--workers", "1", "-o", out]
    done = scenetruth(*words)
    assert done.returncode == 0, done.stderr
    assert "2 points with 2 seeds: 4 simulations, 4 of them to run" in done.stderr
    assert "smallest RMSE of each quantity, region interior" in done.stdout
    assert "stage.baseline_mm = 1" in done.stdout
    assert {name for name in names(out) if not name.startswith(".")} == RESULTS
    assert "4 simulations, 0 of them to run" in scenetruth(*words).stderr
    frame = pd.read_parquet(out / "results.parquet")
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
    assert done.stderr.startswith("error: 2 problems with the sweep")
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

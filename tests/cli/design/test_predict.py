"""``scenetruth design predict``, and what ``scenetruth check`` tells of precision."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import yaml

from tests.cli.calling import scenetruth
from tests.design.predict.scenes import wall
from tests.scenes import SCENES


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

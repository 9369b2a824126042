"""The commands that find the best rig and make patterns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from tests.helpers.command_line import names, scenetruth
from tests.helpers.small_specification import spec

FEW = {"predictions": 20, "morris_trajectories": 1, "sobol": 0}


@pytest.mark.usefixtures("undrawn_figures")
def test_a_rig_is_found_and_told(tmp_path: Path) -> None:
    file, out = tmp_path / "spec.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(spec(search=FEW)))
    words: list[str | Path] = ["design", "optimise", file, "--workers", "1", "-o", out]
    done = scenetruth(*words)
    assert done.returncode == 0, done.stderr
    assert "A wall: the best rigs" in done.stdout
    assert "recommended, rig" in done.stdout
    # Rigs are columns: the titles of variables are not broken.
    assert "│ baseline, mm " in done.stdout
    assert "predicted: image noise as in `scenetruth design predict`, and stage errors" in done.stdout
    assert "simulated: all errors against the ground truth" in done.stdout
    assert names(out) >= {"index.html", "recommended.yaml", "pareto_front.csv", "evaluations.csv", "design.json"}
    # Again, with nothing left to do, it says the same.
    assert scenetruth(*words).stdout == done.stdout


def test_what_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    file = tmp_path / "spec.yaml"
    file.write_text(yaml.safe_dump(spec(objectives=[{"quantity": "depht"}], variables={"stage.baseline_mm": {}})))
    done = scenetruth("design", "optimise", file, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.startswith("error: 2 problems with the design specification")
    done = scenetruth("design", "optimise", file)
    assert done.returncode == 2
    assert "--output" in done.stderr
    assert not (tmp_path / "out").exists()


MADE = {
    "pattern.pdf",
    "pattern.svg",
    "pattern.png",
    "pattern.json",
    "scene_lines.yaml",
    "assessment.csv",
    "assessment.png",
}
RIG = ("--focal-length-px", "2000", "--distance-mm", "400", "--size-mm", "50x40")


def test_a_pattern_is_made_and_compared(tmp_path: Path) -> None:
    photograph = np.random.default_rng(3).random((80, 80))
    Image.fromarray(np.uint8(255 * photograph)).save(tmp_path / "mine.png")
    out = tmp_path / "out"
    done = scenetruth("design", "pattern", *RIG, "--dot-px", "5", "--reference-image", tmp_path / "mine.png", "-o", out)
    assert done.returncode == 0, done.stderr
    assert names(out) == MADE
    assert "dots of 1.000 mm (5.00 px)" in done.stdout
    assert "mine.png: " in done.stdout
    assert "times the noise of depth and motion (reference: speckle)" in done.stdout
    assert "texture: {kind: image" in done.stdout
    table = pd.read_csv(out / "assessment.csv")
    assert set(table["pattern"]) == {"speckle", "mine.png"}
    again = scenetruth("design", "pattern", *RIG, "-o", out)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    # Fewer pages, more pages: what is ours is replaced, and nothing else.
    (out / "notes.txt").write_text("mine")
    again = scenetruth("design", "pattern", *RIG, "--page", "80x110", "-o", out, "--overwrite")
    assert again.returncode == 0, again.stderr
    assert "notes.txt" in names(out)
    assert "pattern.svg" not in names(out)
    assert "pattern_1.svg" in names(out)


def test_bad_input_is_told_at_once(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = scenetruth("design", "pattern", "--distance-mm", "-4", "-o", out)
    assert done.returncode == 2
    assert "focal_length_px: is missing" in done.stderr
    assert "distance_mm" in done.stderr
    wrong = ("--wavelength-px", "5", "--size-mm", "large", "--set", "seed=1", "--mm-per-px", "0.1")
    done = scenetruth("design", "pattern", *RIG, *wrong, "-o", out)
    assert done.returncode == 2
    assert "wavelength_px: must be two numbers" in done.stderr
    assert "size_mm: must be two numbers" in done.stderr
    assert "--set: changes a scene" in done.stderr
    assert "--mm-per-px: applies to a photograph" in done.stderr
    done = scenetruth("design", "pattern", *RIG, "--type", "noise", "--spacing", "1", "--page", "B7", "-o", out)
    assert done.returncode == 2
    assert "spacing: unknown key" in done.stderr
    assert not out.exists()


def test_a_calibration_board_is_written(tmp_path: Path) -> None:
    rig = ("--focal-length-px", "2500", "--distance-mm", "600")
    lengths = ("--board", "dots=[7,5]", "--board", "spacing_mm=9", "--board", "diameter_mm=4")
    done = scenetruth("design", "pattern", *rig, "--type", "dots", *lengths, "-o", tmp_path / "board")
    assert done.returncode == 0, done.stderr
    assert "dots of 72 x 54 mm: 7 x 5 dots of 4 mm (16.7 px), 9 mm apart in a row" in done.stdout
    assert names(tmp_path / "board") == {"board.pdf", "board.png", "board.svg", "board.yaml"}
    section = yaml.safe_load((tmp_path / "board" / "board.yaml").read_text())["board"]
    lengths_mm = {"spacing_mm": 9.0, "diameter_mm": 4.0}
    assert section == {"kind": "dots", "dots": [7, 5], **lengths_mm, "dark": True, "scale_std": 1e-3}
    done = scenetruth("design", "pattern", *rig, "--type", "dots", "--dot-px", "5", *lengths, "-o", tmp_path / "other")
    assert done.returncode == 2
    assert "--dot-px: does not apply to calibration boards (--type dots)" in done.stderr
    done = scenetruth("design", "pattern", *rig, *lengths, "-o", tmp_path / "other")
    assert done.returncode == 2
    assert "--board: applies to calibration boards, not to --type speckle" in done.stderr
    assert not (tmp_path / "other").exists()

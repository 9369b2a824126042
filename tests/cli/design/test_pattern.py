"""The command that makes patterns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from tests.cli.calling import names, scenetruth

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
    assert "spacing: is unknown" in done.stderr
    assert not out.exists()

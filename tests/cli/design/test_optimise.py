"""The command that finds the best rig for a goal."""

from __future__ import annotations

from pathlib import Path

import yaml

from tests.cli.calling import names, scenetruth
from tests.design.optimise.small import goal

FEW = {"predictions": 20, "morris": 1, "sobol": 0}


def test_a_rig_is_found_and_told(tmp_path: Path) -> None:
    file, out = tmp_path / "goal.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(goal(search=FEW)))
    words: list[str | Path] = ["design", "optimise", file, "--workers", "1", "-o", out]
    done = scenetruth(*words)
    assert done.returncode == 0, done.stderr
    assert "A wall: the best rigs" in done.stdout
    assert "recommended, rig" in done.stdout
    assert names(out) >= {"index.html", "recommended.yaml", "front.csv", "screened.csv", "design.json"}
    # Again, with nothing left to do, it says the same.
    assert scenetruth(*words).stdout == done.stdout


def test_what_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    file = tmp_path / "goal.yaml"
    file.write_text(yaml.safe_dump(goal(objectives=[{"quantity": "depht"}], free={"stage.baseline_mm": {}})))
    done = scenetruth("design", "optimise", file, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.startswith("error: 2 problems with the goal")
    done = scenetruth("design", "optimise", file)
    assert done.returncode == 2
    assert "--output: is missing" in done.stderr
    assert not (tmp_path / "out").exists()

"""The command of the error budget, as a user runs it."""

from __future__ import annotations

from pathlib import Path

import yaml

from tests.cli.calling import scenetruth
from tests.design.budget.scenes import laboratory


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
    assert (tmp_path / "b" / "waterfall.png").exists()
    wrong = scenetruth("design", "budget", file, *few, "--region", "nowhere")
    assert wrong.returncode == 2
    assert "interior" in wrong.stderr
    refused = scenetruth("design", "budget", file, "--set", "camera.width=nothing")
    assert refused.returncode == 2
    assert "camera.width" in refused.stderr

"""The command `capture simulate`."""

from __future__ import annotations

from pathlib import Path

import yaml

from tests.helpers.command_line import scenetruth
from tests.helpers.scenes import cube

SMALL = {
    "camera": {"width": 96, "height": 72, "focal_length_px": 750},
    "stage": {"positions": 3, "baseline_mm": 3},
    "frames": {"count": 2},
    "sensor": {"noise_std": 0.005, "bit_depth": 10},
}


def test_capture_folder_is_written_and_resumed(tmp_path: Path) -> None:
    scene, output = tmp_path / "scene.yaml", tmp_path / "capture"
    scene.write_text(yaml.safe_dump(cube(**SMALL).to_dict()))
    board = "board={kind: checkerboard, squares: [6, 5], square_mm: 7}"
    options = ("--setting", board, "--poses", "2", "--dark", "1", "--flat", "0", "--set", "frames.count=1")
    done = scenetruth("capture", "simulate", scene, "-o", output, *options)
    assert done.returncode == 0, done.stderr
    assert f"wrote {output / 'capture.yaml'}, {output / 'truth' / 'parameters.yaml'}" in done.stdout
    assert sorted(path.name for path in output.iterdir() if not path.name.startswith(".")) == [
        "board", "capture.yaml", "dark", "images", "simulated_capture.json", "static", "truth",
    ]  # fmt: skip
    assert len(list((output / "board").iterdir())) == 6
    first = output / "board" / "p00_s+0.tif"
    content = first.read_bytes()
    first.unlink()
    assert scenetruth("capture", "simulate", scene, "-o", output, *options).returncode == 0
    assert first.read_bytes() == content
    again = scenetruth("capture", "simulate", scene, "-o", output, *options, "--seed", "5")
    assert again.returncode == 2
    assert "contains the capture of another scene" in again.stderr


def test_wrong_options_are_named_together(tmp_path: Path) -> None:
    given = ("--poses", "3", "--setting", "poses=4", "--setting", "flat", "-o", tmp_path / "c")
    done = scenetruth("capture", "simulate", "cube", *given)
    assert done.returncode == 2
    assert "--poses: is also given by --setting poses" in done.stderr
    assert "--setting" in done.stderr
    assert not (tmp_path / "c").exists()

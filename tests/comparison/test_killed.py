"""A comparison that is killed goes on, and ends with the same figures."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from tests.nightly import nightly

CASES = ["--case", "phase_of_flow", "--case", "phase_of_disparity", "--case", "slope"]


def command(folder: Path) -> list[str]:
    words = [sys.executable, "-m", "scenetruth", "compare", "structure_tensor", "plane_sweep", "-o", str(folder)]
    return [*words, *CASES, "--workers", "2"]


def figures(folder: Path) -> pd.DataFrame:
    frame = pd.read_parquet(folder / "results.parquet")
    # Times and memory are those of the run.
    return frame[frame["quantity"] != ""].reset_index(drop=True)


@nightly
def test_a_killed_comparison_goes_on(tmp_path: Path) -> None:
    generator = random.Random(1)
    for _ in range(4):
        run = subprocess.Popen(command(tmp_path / "killed"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(generator.uniform(4.0, 12.0))
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
    for name in ("killed", "calm"):
        subprocess.run(command(tmp_path / name), check=True, capture_output=True)
    pd.testing.assert_frame_equal(figures(tmp_path / "killed"), figures(tmp_path / "calm"))
    points = tmp_path / "killed" / "points"
    assert [path for path in points.rglob("*") if path.suffix not in (".json", ".npz") and path.is_file()] == []

"""Whatever moment a run is killed at: results are whole, earlier ones survive, and repeating it leaves nothing over."""

from __future__ import annotations

from pathlib import Path

from tests.pipeline.killing import Killer


def test_runs_that_are_killed(tmp_path: Path) -> None:
    with Killer(tmp_path, seed=0) as killer:
        for number in range(4):
            killer.kill_once(number, earlier=number % 2 == 1)

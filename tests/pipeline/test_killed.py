"""Whatever moment a run is killed at: results are whole, earlier ones survive, and repeating it leaves nothing over."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

from tests.nightly import by_day, nightly
from tests.pipeline.killing import Killer


@by_day
def test_a_run_that_is_killed(tmp_path: Path) -> None:
    with Killer(tmp_path, seed=0) as killer:
        killer.kill_once(0, earlier=True)


@nightly
def test_two_hundred_kills(tmp_path: Path) -> None:
    come: Counter[str] = Counter()
    with Killer(tmp_path, seed=2) as killer:
        for number in range(180):
            come[killer.kill_once(number, earlier=number % 2 == 1)] += 1
            shutil.rmtree(tmp_path / f"place-{number}")
    with Killer(tmp_path, seed=3, stages=("render", "estimate", "score", "report")) as killer:
        for number in range(20):
            come[killer.kill_once(number, earlier=number % 2 == 1)] += 1
            shutil.rmtree(tmp_path / f"place-{number}")
    print(f"how far 200 runs had come when they were killed: {dict(come)}")
    assert len(come) > 3


@nightly
def test_fifty_pairs_of_runs(tmp_path: Path) -> None:
    with Killer(tmp_path, seed=4) as killer, Killer(tmp_path, seed=5) as other:
        for number in range(50):
            killer.two_at_once(other, number, kill=number % 2 == 1)
            shutil.rmtree(tmp_path / f"pair-{number}")

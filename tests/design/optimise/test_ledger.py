"""Predictions that are kept are not made again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from scenetruth.dataset.engine.workers import workers_of
from scenetruth.design.optimise import goal_from_plain
from scenetruth.design.optimise.goal.prepare import Prepared, prepare
from scenetruth.design.optimise.rig.evaluate import Evaluation, Task, evaluate
from scenetruth.design.optimise.search import ledger as module
from scenetruth.design.optimise.search.ledger import Ledger
from tests.design.optimise.small import goal
from tests.nightly import nightly


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(goal_from_plain(goal()))


def made(prepared: Prepared, file: Path, points: list[list[float]]) -> list[Any]:
    found = Ledger(prepared.task, prepared.space, workers_of(0), file)
    try:
        return found.ask(points, "even")
    finally:
        found.close()


def test_predictions_come_back_from_their_file(
    prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "predictions.jsonl"
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9], [0.1, 0.2, 0.1]]
    first = made(prepared, file, points)
    assert len(file.read_text().splitlines()) == 2
    assert first[0] == first[2]
    calls: list[Any] = []

    def counted(task: Task, values: Mapping[str, Any]) -> Evaluation:
        calls.append(values)
        return evaluate(task, values)

    monkeypatch.setattr(module, "evaluate", counted)
    assert made(prepared, file, points) == first
    assert calls == []
    # A line that was cut off by a kill is made again, and spoils no other.
    file.write_text(file.read_text()[:-40])
    assert made(prepared, file, points) == first
    assert len(calls) == 1
    assert made(prepared, file, points) == first
    assert len(calls) == 1


@nightly
def test_workers_predict_the_same(prepared: Prepared) -> None:
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9]]
    alone = Ledger(prepared.task, prepared.space, workers_of(0)).ask(points, "even")
    crew = workers_of(1)
    try:
        assert Ledger(prepared.task, prepared.space, crew).ask(points, "even") == alone
    finally:
        crew.close()

"""Predictions that are kept are not made again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from scenetruth.design.optimisation import DesignSpec, Evaluation, prepare_problem
from scenetruth.design.optimisation import evaluation_log as module
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.problem_setup import OptimisationProblem
from scenetruth.design.optimisation.rig_evaluation import EvaluationTask, evaluate_rig
from scenetruth.jobs.executors import create_executor
from tests.helpers.nightly import nightly
from tests.helpers.small_specification import spec


@pytest.fixture(scope="module")
def prepared() -> OptimisationProblem:
    return prepare_problem(DesignSpec.from_dict(spec()))


def made(prepared: OptimisationProblem, file: Path, points: list[list[float]]) -> list[Any]:
    found = EvaluationLog(prepared.task, prepared.space, create_executor(1), file)
    try:
        return found.ask(points, "even")
    finally:
        found.close()


def test_predictions_come_back_from_their_file(
    prepared: OptimisationProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "predictions.jsonl"
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9], [0.1, 0.2, 0.1]]
    first = made(prepared, file, points)
    assert len(file.read_text().splitlines()) == 2
    assert first[0] == first[2]
    calls: list[Any] = []

    def counted(task: EvaluationTask, values: Mapping[str, Any]) -> Evaluation:
        calls.append(values)
        return evaluate_rig(task, values)

    monkeypatch.setattr(module, "evaluate_rig", counted)
    assert made(prepared, file, points) == first
    assert calls == []
    # A line that was cut off by a kill is made again, and spoils no other.
    file.write_text(file.read_text()[:-40])
    assert made(prepared, file, points) == first
    assert len(calls) == 1
    assert made(prepared, file, points) == first
    assert len(calls) == 1


@nightly
def test_workers_predict_the_same(prepared: OptimisationProblem) -> None:
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9]]
    alone = EvaluationLog(prepared.task, prepared.space, create_executor(1)).ask(points, "even")
    crew = create_executor(2)
    try:
        assert EvaluationLog(prepared.task, prepared.space, crew).ask(points, "even") == alone
    finally:
        crew.close()

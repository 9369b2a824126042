"""Predictions that are kept are not made again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from scenetruth.design.optimisation import (
    DesignSpec,
    EvaluationLog,
    OptimisationProblem,
    prepare_problem,
)
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


def test_predictions_come_back_from_their_file(prepared: OptimisationProblem, tmp_path: Path) -> None:
    file = tmp_path / "predictions.jsonl"
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9], [0.1, 0.2, 0.1]]
    first = made(prepared, file, points)
    assert len(file.read_text().splitlines()) == 2
    assert first[0] == first[2]
    # Whatever is predicted is written to the file.
    kept = file.read_text()
    assert made(prepared, file, points) == first
    assert file.read_text() == kept
    # A line that was cut off by a kill is made again, and spoils no other.
    file.write_text(kept[:-40])
    assert made(prepared, file, points) == first
    repaired = file.read_text()
    assert repaired.startswith(kept[:-40])
    assert repaired.removeprefix(kept[:-40]).strip() == kept.splitlines()[1]
    assert made(prepared, file, points) == first
    assert file.read_text() == repaired


@nightly
def test_workers_predict_the_same(prepared: OptimisationProblem) -> None:
    points = [[0.1, 0.2, 0.1], [0.9, 0.9, 0.9]]
    alone = EvaluationLog(prepared.task, prepared.space, create_executor(1)).ask(points, "even")
    crew = create_executor(2)
    try:
        assert EvaluationLog(prepared.task, prepared.space, crew).ask(points, "even") == alone
    finally:
        crew.close()

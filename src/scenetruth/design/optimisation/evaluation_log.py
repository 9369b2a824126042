"""The log of all evaluations of a search, stored in a file and reused."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scenetruth.design.optimisation.design_records import ConstraintValue
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation, EvaluationTask, evaluate_rig
from scenetruth.jobs.executors import TaskExecutor
from scenetruth.jobs.results import ResultLog
from scenetruth.jobs.scheduler import map_batches
from scenetruth.progress import Progress

__all__ = ["EvaluationLog"]


class EvaluationLog:
    """Evaluations by the values of the design variables.

    With a file, an interrupted search is deterministic when resumed: it requests the same candidates in the same order.

    ``file``: Log file; None for memory only.
    ``progress``, ``total``: Called with ("predictions", done, total); expected number of evaluations.
    """

    def __init__(
        self,
        task: EvaluationTask,
        space: DesignSpace,
        workers: TaskExecutor,
        file: Path | None = None,
        progress: Progress | None = None,
        total: int = 0,
    ) -> None:
        self._task, self._space, self._workers = task, space, workers
        self._progress, self._total = progress, total
        self._known: dict[str, Evaluation] = {}
        self._phases: dict[str, str] = {}
        self._log = ResultLog(file)
        self._kept = _read(self._log.lines)

    def __len__(self) -> int:
        """Return the number of requested evaluations."""
        return len(self._known)

    @property
    def evaluations(self) -> list[Evaluation]:
        """All evaluations, in the order of the first request."""
        return list(self._known.values())

    @property
    def phases(self) -> list[str]:
        """Phase of the first request of each evaluation."""
        return list(self._phases.values())

    def ask(self, points: Sequence[Sequence[float]], phase: str) -> list[Evaluation]:
        """Return the evaluations of points of the unit cube."""
        return self.ask_values([self._space.values(point) for point in points], phase)

    def ask_values(self, many: Sequence[Mapping[str, Any]], phase: str) -> list[Evaluation]:
        """Return the evaluations of candidates given by their values."""
        keys = [_key(values) for values in many]
        wanted = {key: values for key, values in zip(keys, many, strict=True) if key not in self._known}
        for key in wanted:
            self._phases[key] = phase
        missing = {key: values for key, values in wanted.items() if key not in self._kept}
        made = self._made(missing)
        for key in wanted:
            self._known[key] = made[key] if key in made else self._kept[key]
        self._tell()
        return [self._known[key] for key in keys]

    def close(self) -> None:
        """Close the file."""
        self._log.close()

    def _made(self, missing: Mapping[str, Mapping[str, Any]]) -> dict[str, Evaluation]:
        """Evaluate in several processes; failed processes are restarted."""
        found: dict[str, Evaluation] = {}

        def take(key: str, one: Evaluation) -> None:
            found[key] = one
            self._log.append(key, _plain(one))

        map_batches(self._workers, _evaluate_all, self._task, missing, take)
        return found

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress("predictions", min(len(self), self._total), self._total)


def _evaluate_all(task: EvaluationTask, many: Sequence[Mapping[str, Any]]) -> list[Evaluation]:
    return [evaluate_rig(task, values) for values in many]


def _key(values: Mapping[str, Any]) -> str:
    return json.dumps(values, sort_keys=True, ensure_ascii=False, default=str)


def _plain(one: Evaluation) -> dict[str, Any]:
    return {**asdict(one), "constraints": [list(asdict(each).values()) for each in one.constraints]}


def _read(lines: Sequence[Mapping[str, Any]]) -> dict[str, Evaluation]:
    """Return the evaluations of a file; invalid lines are skipped."""
    found = {}
    for line in lines:
        try:
            plain = {name: value for name, value in line.items() if name != "key"}
            plain["constraints"] = tuple(ConstraintValue(*each) for each in plain["constraints"])
            found[line["key"]] = Evaluation(**plain)
        except (KeyError, TypeError):
            continue
    return found

"""The log of all evaluations of a search: computed by workers, appended to a file, never computed twice."""

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
    """The predictions that there are, by the values of the design variables.

    A file keeps them: a search that was killed finds them there, asks for the same rigs again in the same order, and so
    comes to the same end.

    ``task``, ``space``: What is designed.
    ``workers``: Who predicts.
    ``file``: Where predictions are kept; None to keep none.
    ``progress``: Called with ("predictions", done, total).
    ``total``: How many there will be, for progress.
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
        """Return how many rigs were asked for."""
        return len(self._known)

    @property
    def evaluations(self) -> list[Evaluation]:
        """All of them, in the order in which they were first asked for."""
        return list(self._known.values())

    @property
    def phases(self) -> list[str]:
        """For what each was first asked."""
        return list(self._phases.values())

    def ask(self, points: Sequence[Sequence[float]], phase: str) -> list[Evaluation]:
        """Return the predictions of points of the unit cube, in their order."""
        return self.ask_values([self._space.values(point) for point in points], phase)

    def ask_values(self, many: Sequence[Mapping[str, Any]], phase: str) -> list[Evaluation]:
        """Return the predictions of rigs given by their values, in their order."""
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
        """Predict in several processes; those that die are started anew."""
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
    """Return the predictions of a file; lines that hold none are left out."""
    found = {}
    for line in lines:
        try:
            plain = {name: value for name, value in line.items() if name != "key"}
            plain["constraints"] = tuple(ConstraintValue(*each) for each in plain["constraints"])
            found[line["key"]] = Evaluation(**plain)
        except (KeyError, TypeError):
            continue
    return found

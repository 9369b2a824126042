"""The log of all evaluations of a search: computed by workers, appended to a file, never computed twice."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from scenetruth.dataset.executors import TaskExecutor
from scenetruth.design.optimisation.design_records import ConstraintValue
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation, EvaluationTask, evaluate_rig
from scenetruth.errors import MachineError, Problem
from scenetruth.progress import Progress

__all__ = ["EvaluationLog"]

_MOST_LOSSES = 3


class EvaluationLog:
    """The predictions that there are, by the values of the design variables.

    A file keeps them: a search that was killed finds them there, asks for the same rigs again in the same order, and so
    comes to the same end.

    Parameters
    ----------
    task, space
        What is designed.
    workers
        Who predicts.
    file
        Where predictions are kept; None to keep none.
    progress
        Called with ("predictions", done, total).
    total
        How many there will be, for progress.
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
        self._kept = _read(file) if file is not None else {}
        self._stream: TextIO | None = None
        if file is not None:
            _end_line(file)
            self._stream = file.open("a", encoding="utf-8")

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
        """Return the predictions of points of the unit cube, in their order.

        Parameters
        ----------
        points
            The points.
        phase
            What they are for.
        """
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
        if self._stream is not None:
            self._stream.close()

    def _made(self, missing: Mapping[str, Mapping[str, Any]]) -> dict[str, Evaluation]:
        """Predict in several processes; those that die are started anew."""
        left, found, losses = dict(missing), dict[str, Evaluation](), 0
        while left:
            batches = _batches(left, self._workers.count)
            futures: list[tuple[list[str], Future[list[Evaluation]]]] = [
                (keys, self._workers.submit(_evaluate_all, self._task, [left[key] for key in keys])) for keys in batches
            ]
            lost = False
            for keys, future in futures:
                try:
                    some = future.result()
                except self._workers.lost:
                    lost = True
                    continue
                for key, one in zip(keys, some, strict=True):
                    found[key] = one
                    del left[key]
                    self._write(key, one)
            if lost:
                losses += 1
                if losses > _MOST_LOSSES:
                    message = "processes that predict are killed again and again; is there enough memory?"
                    raise MachineError([Problem("workers", message, self._workers.count)])
                self._workers.renew()
        return found

    def _write(self, key: str, one: Evaluation) -> None:
        if self._stream is not None:
            line = {"key": key, **_plain(one)}
            self._stream.write(json.dumps(line, ensure_ascii=False) + "\n")
            self._stream.flush()

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress("predictions", min(len(self), self._total), self._total)


def _batches(left: Mapping[str, Any], workers: int) -> list[list[str]]:
    """Return the keys in batches: small enough that no worker waits long for the others."""
    keys = list(left)
    size = max(1, min(8, -(-len(keys) // max(workers, 1))))
    return [keys[start : start + size] for start in range(0, len(keys), size)]


def _evaluate_all(task: EvaluationTask, many: Sequence[Mapping[str, Any]]) -> list[Evaluation]:
    return [evaluate_rig(task, values) for values in many]


def _key(values: Mapping[str, Any]) -> str:
    return json.dumps(values, sort_keys=True, ensure_ascii=False, default=str)


def _plain(one: Evaluation) -> dict[str, Any]:
    return {**asdict(one), "constraints": [list(asdict(each).values()) for each in one.constraints]}


def _read(file: Path) -> dict[str, Evaluation]:
    """Return what a file keeps; a last line that was cut off is left out."""
    found = {}
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return {}
    for line in lines:
        try:
            plain: dict[str, Any] = json.loads(line)
            key = plain.pop("key")
            plain["constraints"] = tuple(ConstraintValue(*each) for each in plain["constraints"])
            found[key] = Evaluation(**plain)
        except (ValueError, KeyError, TypeError):
            continue
    return found


def _end_line(file: Path) -> None:
    """Begin a new line after one that was cut off."""
    if not file.exists() or not file.stat().st_size:
        return
    with file.open("rb+") as stream:
        stream.seek(-1, os.SEEK_END)
        if stream.read(1) != b"\n":
            stream.write(b"\n")

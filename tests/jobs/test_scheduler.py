"""Every sample is made once, whatever becomes of processes, and only where there is room for it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from scenetruth.errors import StoreError
from scenetruth.jobs.executors import ProcessExecutor
from scenetruth.jobs.results import TaskResult
from scenetruth.jobs.scheduler import ResourceGuard, TaskScheduler, write_with_retry
from scenetruth.output import is_full_disk
from tests.helpers.nightly import nightly


def work(folder: str, number: int) -> TaskResult:
    """Leave a mark; some numbers fail, or kill their process, the first time or always."""
    marks = Path(folder)
    (marks / f"{number}-{time.monotonic_ns()}").touch()
    tries = len(list(marks.glob(f"{number}-*")))
    if number == 5 or (number == 6 and tries == 1):
        return TaskResult(number, failure={"message": "bad"})
    if number == 7 or (number == 8 and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return TaskResult(number, {"threads": os.environ.get("NUMBA_NUM_THREADS"), "process": os.getpid()})


class Notes:
    def __init__(self) -> None:
        self.made: list[TaskResult] = []
        self.failed: dict[int, tuple[dict[str, Any], int]] = {}
        self.said: list[str] = []

    def drive(
        self, workers: Any, folder: Path, work: Callable[..., TaskResult] = work, **options: Any
    ) -> TaskScheduler:
        def failed(found: TaskResult, attempts: int) -> None:
            self.failed[found.number] = (found.failure, attempts)

        return TaskScheduler(workers, work, (str(folder),), self.made.append, failed, self.said.append, **options)


@nightly
def test_every_sample_is_made_once_and_the_guilty_ones_alone_are_set_aside(tmp_path: Path) -> None:
    notes, workers = Notes(), ProcessExecutor(2)
    try:
        notes.drive(workers, tmp_path, retries=1).run(range(10))
        workers.renew()
    finally:
        workers.close()
    assert sorted(found.number for found in notes.made) == [0, 1, 2, 3, 4, 6, 8, 9]
    assert {found.values["threads"] for found in notes.made} == {"1"}
    assert notes.failed[5] == ({"message": "bad"}, 2)
    assert notes.failed[7][0]["error"] == "WorkerDied"
    assert notes.failed[7][1] == 2
    assert set(notes.failed) == {5, 7}


class InThisProcess:
    """Workers that do their work when it is handed in."""

    count, lost = 2, (ZeroDivisionError,)

    def __init__(self) -> None:
        self.renewed = 0
        self.under_way = 0

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments))
        except ZeroDivisionError as error:
            future.set_exception(error)
        return future

    def renew(self) -> None:
        self.renewed += 1

    def refuse_unfit(self) -> None:
        pass

    def close(self) -> None:
        pass


def fine(folder: str, number: int) -> TaskResult:
    return TaskResult(number, {"number": number})


def test_processes_are_started_anew_after_so_many_samples(tmp_path: Path) -> None:
    notes, workers = Notes(), InThisProcess()
    notes.drive(workers, tmp_path, fine, recycle=5).run(range(35))
    assert len(notes.made) == 35
    # Two processes of five samples each.
    assert workers.renewed == 3


def test_it_pauses_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler._POLL_S", 0.0)
    reasons = iter(["", "", "disk full", "disk full", "", "", "", "", "", "", "", "", ""])
    notes = Notes()
    notes.drive(InThisProcess(), tmp_path, fine, pause=lambda: next(reasons)).run(range(5))
    assert sorted(found.number for found in notes.made) == [0, 1, 2, 3, 4]
    assert notes.said == ["paused: disk full", "resumed"]


@nightly
def test_a_full_disk_is_no_fault_of_a_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler._POLL_S", 0.01)
    monkeypatch.setattr("scenetruth.jobs.scheduler.FULL_S", 0.02)

    def writing(folder: str, number: int) -> TaskResult:
        (Path(folder) / f"{number}-{time.monotonic_ns()}").touch()
        tries = len(list(Path(folder).glob(f"{number}-*")))
        full = number in (1, 3) and tries < 5
        return TaskResult(number, failure={"message": "no space"} if full else {}, disk_full=full)

    notes = Notes()
    notes.drive(InThisProcess(), tmp_path, writing, retries=1).run(range(6))
    assert sorted(found.number for found in notes.made) == [0, 1, 2, 3, 4, 5]
    assert notes.failed == {}
    assert notes.said[0].startswith("paused: the disk is full")
    assert notes.said[-1] == "resumed"


@nightly
def test_a_script_that_cannot_start_processes_is_told_so(tmp_path: Path) -> None:
    """Without the usual guard, every process would run the script again."""
    script = tmp_path / "script.py"
    recipe = "from tests.helpers.small_recipes import RECIPE\nimport scenetruth as st\n"
    run = f"st.run_dataset(RECIPE, output={str(tmp_path / 'new')!r}, workers=2)\n"
    script.write_text(recipe + run, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert ended.returncode != 0
    assert "call it below `if __name__ == '__main__':`" in ended.stderr


def full() -> StoreError:
    error = StoreError("a.parquet", "the disk is full")
    error.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    return error


def test_a_full_disk_is_known_behind_other_errors() -> None:
    assert is_full_disk(OSError(errno.EDQUOT, "quota"))
    assert is_full_disk(full())
    assert not is_full_disk(OSError(errno.EACCES, "denied"))
    assert not is_full_disk(StoreError("a", "the disk is full"))


def test_what_finds_the_disk_full_is_written_when_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler.FULL_S", 0.0)
    errors = [full(), full()]

    def write() -> None:
        if errors:
            raise errors.pop()

    said: list[str] = []
    write_with_retry(write, "the catalogue", said.append)
    assert [line.split(",")[0] for line in said] == ["paused: the disk is full", "resumed"]

    def refused() -> None:
        raise OSError(errno.EACCES, "denied")

    with pytest.raises(OSError, match="denied"):
        write_with_retry(refused, "the catalogue", said.append)


@pytest.mark.parametrize(
    ("disk", "memory", "told"),
    [(1e9, 1e9, ""), (3.1e8, 1e9, "the disk is nearly full"), (1e9, 1e7, "memory is short"), (None, None, "")],
)
def test_no_sample_is_begun_without_room(
    disk: float | None, memory: float | None, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler.free_disk_bytes", lambda folder: disk)
    monkeypatch.setattr("scenetruth.jobs.scheduler.free_memory_bytes", lambda: memory)
    assert ResourceGuard(tmp_path, 2e8, 2e7)().startswith(told)
    assert bool(ResourceGuard(tmp_path, 2e8, 2e7)()) == bool(told)

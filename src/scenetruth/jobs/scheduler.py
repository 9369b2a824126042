"""Scheduling of tasks: retries, pauses while disk space or memory is short, and parallel maps."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.errors import MachineError, Problem, ScenetruthError
from scenetruth.jobs.executors import TaskExecutor, create_executor
from scenetruth.jobs.results import TaskResult
from scenetruth.output import is_full_disk
from scenetruth.progress import Progress
from scenetruth.resources.system import free_disk_bytes, free_memory_bytes

__all__ = ["ParallelResult", "ResourceGuard", "TaskScheduler", "for_each", "map_batches", "write_with_retry"]


_RECHECK_S = 2.0
FULL_S = 5.0
"""Seconds between attempts to write to a full disk."""
_SPARE_BYTES = 200e6  # disk space kept free, in bytes


@dataclass
class ResourceGuard:
    """Test whether disk space (``disk_bytes`` for running tasks) and memory per task suffice for another task."""

    folder: Path
    disk_bytes: float
    memory_bytes: float
    _looked: float = -1e9
    _reason: str = ""

    def __call__(self) -> str:
        """Return why no task may start now; empty if one may."""
        if time.monotonic() - self._looked > _RECHECK_S:
            self._looked, self._reason = time.monotonic(), self._look()
        return self._reason

    def _look(self) -> str:
        disk, memory = free_disk_bytes(self.folder), free_memory_bytes()
        wanted = self.disk_bytes + _SPARE_BYTES
        if disk is not None and disk < wanted:
            return (
                f"the disk is nearly full: {disk / 1e6:,.0f} MB are free, {wanted / 1e6:,.0f} are needed; "
                "free some, the job resumes automatically; or interrupt it, and run it again later"
            )
        if memory is not None and memory < self.memory_bytes:
            return (
                f"memory is short: {memory / 1e6:,.0f} MB are free, a sample takes {self.memory_bytes / 1e6:,.0f}; "
                "the job resumes automatically when more is free; or interrupt it, and run it again with fewer workers"
            )
        return ""


def write_with_retry(write: Callable[[], None], what: str, say: Callable[[str], None]) -> None:
    """Write, and retry while the disk is full."""
    values = False
    while True:
        try:
            write()
        except (OSError, ScenetruthError) as error:
            if not is_full_disk(error):
                raise
            if not values:
                say(f"paused: the disk is full, {what} cannot be written; free some, the job resumes automatically")
            values = True
            time.sleep(FULL_S)
        else:
            if values:
                say("resumed")
            return


_AHEAD = 2  # number of submitted tasks per worker: one running, one queued
_POLL_S = 1.0
_DIED = "its process died: killed, out of memory, or a crash of compiled code"


@dataclass
class TaskScheduler:
    """Scheduler of tasks, each of which is one call in a worker.

    ``work``: Called with ``arguments`` and the number of the task; returns `TaskResult`. ``retries``: Number of retries
    of a failed task, after all others, in a new process; without limit if the disk was full. ``recycle``: Number of
    tasks after which local processes are restarted. ``pause``: Returns why no task may start now; empty if one may.
    ``made``, ``failed``: Called with every successful result and every final failure. ``said``: Called with messages.
    """

    workers: TaskExecutor
    work: Callable[..., TaskResult]
    arguments: tuple[Any, ...]
    made: Callable[[TaskResult], None]
    failed: Callable[[TaskResult, int], None]
    said: Callable[[str], None]
    pause: Callable[[], str] = lambda: ""
    retries: int = 1
    recycle: int = 500
    _proven: bool = False
    _full_until: float = -1e9

    def run(self, numbers: Iterable[int]) -> None:
        """Perform tasks; failed tasks are retried after all others."""
        left: deque[int] = deque(numbers)
        attempts: dict[int, int] = {}
        while left:
            again: list[TaskResult] = []
            if attempts:
                self.workers.renew()
            self._through(left, again)
            for found in again:
                if found.disk_full:
                    left.append(found.number)
                    continue
                attempts[found.number] = attempts.get(found.number, 0) + 1
                if attempts[found.number] > self.retries:
                    self.failed(found, attempts[found.number])
                else:
                    left.append(found.number)

    def _through(self, left: deque[int], again: list[TaskResult]) -> None:
        under_way: dict[Future[Any], int] = {}
        begun, suspects, paused = 0, list[int](), ""
        while left or under_way or suspects:
            due = begun >= self.recycle * self.workers.count
            if not under_way and (due or suspects):
                self.workers.renew()
                if suspects and not self._proven:
                    self.workers.refuse_unfit()
                # All running tasks died together: they are repeated singly to identify the cause.
                for number in suspects:
                    self._by_itself(number, again)
                begun, suspects = 0, []
                continue
            if left and not due and not suspects and len(under_way) < _AHEAD * self.workers.count:
                paused = self._told_pause(paused)
                if not paused:
                    number = left.popleft()
                    under_way[self.workers.submit(self.work, *self.arguments, number)] = number
                    begun += 1
                    # Local results are collected before another task starts.
                    if not any(future.done() for future in under_way):
                        continue
            if not under_way:
                time.sleep(_POLL_S)
                continue
            done, _ = wait(under_way, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in done:
                number = under_way.pop(future)
                try:
                    self._take(future.result(), again)
                except self.workers.lost:
                    suspects.append(number)
                except CancelledError:
                    self.workers.refuse_unfit()
                    suspects.append(number)

    def _by_itself(self, number: int, again: list[TaskResult]) -> None:
        """Perform one task alone: if a process dies now, this task is the cause."""
        future = self.workers.submit(self.work, *self.arguments, number)
        while True:
            done, _ = wait([future], timeout=_POLL_S)
            if done:
                break
        try:
            self._take(future.result(), again)
        except self.workers.lost:
            self.workers.renew()
            again.append(_died(number))
        except CancelledError:
            self.workers.refuse_unfit()
            again.append(_died(number))

    def _take(self, found: TaskResult, again: list[TaskResult]) -> None:
        self._proven = True
        if found.disk_full:
            self._full_until = time.monotonic() + FULL_S
        if found.failure:
            again.append(found)
        else:
            self.made(found)

    def _told_pause(self, before: str) -> str:
        """Return why no task may start now, and report changes."""
        reason = self.pause()
        if not reason and time.monotonic() < self._full_until:
            reason = "the disk is full: a sample could not be written; free some space, the job resumes automatically"
        if reason and not before:
            self.said(f"paused: {reason}")
        elif before and not reason:
            self.said("resumed")
        return reason


def _died(number: int) -> TaskResult:
    return TaskResult(number, failure={"sample": number, "error": "WorkerDied", "message": _DIED})


@dataclass
class ParallelResult:
    """Numbers of tasks completed in this run and before, and errors by number of the sample."""

    done: int = 0
    present: int = 0
    failed: dict[int, str] = field(default_factory=dict)


def for_each(
    numbers: Sequence[int],
    work: Callable[..., TaskResult],
    arguments: tuple[Any, ...],
    *,
    present: int = 0,
    workers: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    retries: int = 0,
    what: str = "samples",
    made: Callable[[TaskResult], None] | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> ParallelResult:
    """Perform a task for each sample."""
    found, say = ParallelResult(present=present), notice or (lambda _: None)
    total = len(numbers) + present

    def tell() -> None:
        if progress is not None:
            progress(what, found.done + found.present + len(found.failed), total)

    def take(one: TaskResult) -> None:
        found.done += 1
        if made is not None:
            made(one)
        tell()

    def failed(one: TaskResult, attempts: int) -> None:
        message = " ".join(str(one.failure["message"]).split())
        found.failed[one.number] = message
        say(f"sample {one.number} failed: {message}")
        tell()

    crew = create_executor(workers, threads, scheduler)
    try:
        tell()
        TaskScheduler(crew, work, arguments, take, failed, say, retries=retries).run(numbers)
        crew.renew()
    finally:
        crew.close()
    return found


_MAX_LOSSES, _MAX_BATCH = 3, 8


def map_batches(
    executor: TaskExecutor,
    work: Callable[..., list[Any]],
    shared: Any,
    items: Mapping[str, Any],
    take: Callable[[str, Any], None],
) -> None:
    """Perform short tasks in batches, and restart processes that die."""
    left, losses = dict(items), 0
    while left:
        futures: list[tuple[list[str], Future[list[Any]]]] = [
            (keys, executor.submit(work, shared, [left[key] for key in keys]))
            for keys in _split_batches(left, executor.count)
        ]
        lost = False
        for keys, future in futures:
            try:
                results = future.result()
            except CancelledError:
                executor.refuse_unfit()
                lost = True
                continue
            except executor.lost:
                lost = True
                continue
            for key, result in zip(keys, results, strict=True):
                del left[key]
                take(key, result)
        if lost:
            losses += 1
            if losses > _MAX_LOSSES:
                message = "worker processes are killed repeatedly; check that there is enough memory"
                raise MachineError([Problem("workers", message, executor.count)])
            executor.renew()


def _split_batches(left: Mapping[str, Any], workers: int) -> list[list[str]]:
    keys = list(left)
    size = max(1, min(_MAX_BATCH, -(-len(keys) // max(workers, 1))))
    return [keys[start : start + size] for start in range(0, len(keys), size)]

"""Executors: serial, local processes and Dask, and an ordered map over them."""

from __future__ import annotations

import multiprocessing
import operator
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.context import BaseContext
from typing import Any, Protocol

from scenetruth.errors import ArgumentError, MachineError, Problem
from scenetruth.jobs.worker_setup import run_with_threads, start_worker

__all__ = [
    "DaskExecutor",
    "ProcessExecutor",
    "SerialExecutor",
    "TaskExecutor",
    "create_executor",
    "describe_pickling_error",
    "ordered_map",
    "resolve_workers",
]


class TaskExecutor(Protocol):
    """Executor of tasks that survives the death of its processes."""

    @property
    def count(self) -> int:
        """Number of simultaneous tasks."""
        ...

    @property
    def lost(self) -> tuple[type[BaseException], ...]:
        """Exceptions of a task whose process has died."""
        ...

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a task."""
        ...

    def renew(self) -> None:
        """Restart the processes after a failure or to release memory; no task may be running."""
        ...

    def refuse_unfit(self) -> None:
        """Raise if no process can be started."""
        ...

    def close(self) -> None:
        """End all processes immediately; running tasks are lost."""
        ...


class ProcessExecutor:
    """Local processes without the state of this one: ``count`` processes with ``threads`` threads each."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, count: int, threads: int = 1) -> None:
        self.count, self._threads = count, threads
        self._pool: ProcessPoolExecutor | None = None

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a task."""
        if self._pool is None:
            _track_quietly()
            self._pool = ProcessPoolExecutor(self.count, _context(), start_worker, (self._threads, dict(os.environ)))
        try:
            return self._pool.submit(work, *arguments)
        except BrokenExecutor as error:
            # Equivalent to a submitted task whose process has died.
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def renew(self) -> None:
        """Restart the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def refuse_unfit(self) -> None:
        """Raise if no process can be started."""
        try:
            self.submit(os.getpid).result()
        except BrokenExecutor as error:
            message = (
                "no process can be started; in a script, call it below `if __name__ == '__main__':`, because processes "
            )
            message += "import the script, or use no processes: workers=1"
            raise MachineError([Problem("workers", message, self.count)]) from error

    def close(self) -> None:
        """End all processes immediately."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        # Python before 3.14 has no public interface to end running processes.
        processes = list((getattr(pool, "_processes", None) or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            with suppress(Exception):
                process.kill()
        for process in processes:
            with suppress(Exception):
                process.join(10)


def _context() -> BaseContext:
    """Return how processes are started: where it is safe, forked from a process that has imported the libraries.

    Each import takes 2 to 3 s of a processor.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    # Without effect on a process that runs already.
    context.set_forkserver_preload(["scenetruth.jobs.worker_imports"])
    return context


def _track_quietly() -> None:
    """Start the process that removes the locks of killed processes, so that no warning is printed."""
    option = "ignore:resource_tracker:UserWarning"
    sys.warnoptions.append(option)
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(option)


class SerialExecutor:
    """Executor in this process, for debugging and for few small tasks."""

    lost: tuple[type[BaseException], ...] = ()
    count = 1

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Execute a task immediately."""
        future: Future[Any] = Future()
        future.set_result(work(*arguments))
        return future

    def renew(self) -> None:
        """Do nothing."""

    def refuse_unfit(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class DaskExecutor:
    """Dask workers at ``address``, ``tcp://host:8786`` or a scheduler file, with ``at_once`` submitted tasks each."""

    def __init__(self, address: str, threads: int = 1, at_once: int = 2) -> None:
        try:
            from distributed import Client, KilledWorker
            from distributed.client import FutureCancelledError
        except ImportError as error:
            message = "needs Dask: pip install 'scenetruth[cluster]'"
            raise MachineError([Problem("--scheduler", message, address)]) from error
        self.lost: tuple[type[BaseException], ...] = (KilledWorker, FutureCancelledError)
        try:
            named = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
            self._client = Client(**named, timeout=_PATIENCE_S)
        except (OSError, ValueError, TimeoutError) as error:
            message = f"the scheduler does not respond: {error}"
            raise MachineError([Problem("--scheduler", message, address)]) from error
        self.dashboard: str = self._client.dashboard_link
        self._threads, self._at_once, self._address = threads, at_once, address
        self._executor: Executor = self._client.get_executor(pure=False, retries=0)

    @property
    def count(self) -> int:
        """Number of simultaneous tasks."""
        threads = sum(self._client.nthreads().values())
        return max(int(threads), 1) * self._at_once

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a task."""
        return self._executor.submit(run_with_threads, self._threads, work, *arguments)

    def renew(self) -> None:
        """Do nothing: the cluster manages its workers."""

    def refuse_unfit(self) -> None:
        """Raise if the scheduler does not respond."""
        if self._client.status != "running":
            message = "the scheduler no longer responds; finished results are kept: start it, and repeat the command"
            raise MachineError([Problem("--scheduler", message, self._address)])

    def close(self) -> None:
        """Cancel pending tasks, and disconnect from the cluster."""
        with suppress(Exception):
            self._executor.shutdown(wait=False, cancel_futures=True)
        with suppress(Exception):
            self._client.close(timeout=_PATIENCE_S)


_PATIENCE_S = 20


def resolve_workers(workers: int) -> int:
    """Return the number of worker processes for an argument ``workers``.

    >>> resolve_workers(4)
    4
    >>> resolve_workers(0)
    Traceback (most recent call last):
    ...
    scenetruth.errors.ArgumentError: 1 problem with the arguments:
      - workers: must be 1 or more, or -1 for all processors (got 0)
    """
    try:
        count = 0 if isinstance(workers, bool) else operator.index(workers)
    except TypeError:
        count = 0
    if count == -1:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if count < 1:
        raise ArgumentError([Problem("workers", "must be 1 or more, or -1 for all processors", workers)])
    return count


def create_executor(workers: int = 1, threads: int = 1, scheduler: str | None = None) -> TaskExecutor:
    """Return the executor of a job."""
    count = resolve_workers(workers)
    if scheduler is not None:
        return DaskExecutor(scheduler, threads)
    return ProcessExecutor(count, threads) if count > 1 else SerialExecutor()


def describe_pickling_error(value: Any, workers: int, scheduler: str | None = None) -> str:
    """Return why a value cannot be sent to the workers of a job; empty if it can, or need not."""
    if scheduler is None and resolve_workers(workers) == 1:
        return ""
    try:
        pickle.dumps(value)
    except Exception as error:  # pickling raises errors of any type
        return str(error) or type(error).__name__
    return ""


MIN_PARALLEL_S = 10.0
"""Minimum duration in seconds of a task for which processes are started."""


def ordered_map(
    work: Callable[..., Any], shared: Any, things: Iterable[Any], workers: int = 1, scheduler: str | None = None
) -> Iterator[Any]:
    """Yield ``work(shared, thing)`` for each thing, in order."""
    parallel = scheduler is not None or resolve_workers(workers) > 1
    left = list(things)
    seconds = 0.0
    # The first call may include loading or compilation; the second is timed.
    for thing in left[:2] if parallel else left:
        start = time.perf_counter()
        yield work(shared, thing)
        seconds = time.perf_counter() - start
    if not parallel:
        return
    left = left[2:]
    if seconds * len(left) < MIN_PARALLEL_S:
        yield from (work(shared, thing) for thing in left)
        return
    crew = create_executor(workers, 1, scheduler)
    try:
        crew.refuse_unfit()
        futures: list[Future[Any]] = [crew.submit(work, shared, thing) for thing in left]
        yield from (future.result() for future in futures)
    finally:
        crew.close()

"""Parallel execution of tasks and row bands in threads, and linear algebra in a single one."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache, wraps
from itertools import islice
from typing import Any, ParamSpec, TypeVar

from scenetruth import compilation

__all__ = ["bands", "in_bands", "in_order", "in_threads", "with_one_blas_thread"]

_P = ParamSpec("_P")
_R = TypeVar("_R")
_J = TypeVar("_J")

# Bands per thread, to balance bands of different cost.
_BANDS = 2


def in_threads(work: Callable[[Any], None], jobs: Iterable[Any]) -> None:
    """Perform all tasks in threads, including the calling thread, and re-raise any exception; calls may be nested."""
    left = deque(jobs)
    works = [work]

    def take() -> None:
        while True:
            try:
                job = left.popleft()
            except IndexError:
                return
            works[0](job)

    helpers = min(_count_free_threads(), len(left)) - 1
    started = [_pool(compilation.thread_count()).submit(take) for _ in range(helpers)]
    try:
        take()
    finally:
        # All tasks have started, unless this thread was interrupted: then pending tasks are dropped. Pending helpers
        # have nothing to do and are not awaited: all threads may be waiting for tasks of their own.
        left.clear()
        begun = [helper for helper in started if not helper.cancel()]
        wait(begun)
        # Cancelled helpers stay in the queue of the pool until a thread is free, but the arrays of the tasks do not.
        works.clear()
    for helper in begun:
        helper.result()


def in_bands(kernel: Callable[..., None], count: int, *arguments: Any, least: int = 1024) -> None:
    """Call a kernel in threads on bands that cover the indices from 0 to ``count`` - 1 once each.

    ``count``: Number of indices. With 0, the kernel is not called.
    ``least``: Minimum number of indices per call, equivalent to some tens of microseconds.
    """
    threads = _count_free_threads()
    parts = 1 if threads == 1 else max(min(_BANDS * threads, count // least), 1)
    if parts == 1:
        if count > 0:
            kernel(0, count, *arguments)
        return
    in_threads(
        lambda part: kernel(count * part // parts, count * (part + 1) // parts, *arguments),
        range(parts),
    )


def in_order(work: Callable[[_J], _R], jobs: Iterable[_J], at_once: int) -> Generator[_R, None, None]:
    """Yield the results of tasks in the order of the tasks, while threads perform the next ``at_once`` tasks.

    Tasks may use `in_threads` themselves: threads that have no task of their own take part. With a single thread, a
    task is performed when its result is required. After an exception, or when the generator is closed, no further task
    is started.
    """
    if compilation.thread_count() == 1:
        for job in jobs:
            yield work(job)
        return
    pool, left = _pool(compilation.thread_count()), iter(jobs)
    started: deque[Future[_R]] = deque()

    def start(count: int) -> None:
        for job in islice(left, count):
            _occupied.append(None)
            task = pool.submit(work, job)
            task.add_done_callback(lambda _: _occupied.pop())
            started.append(task)

    try:
        start(at_once)
        while started:
            wait([started[0]])
            # The next task starts before the caller processes the result, which is not retained here.
            start(1)
            yield started.popleft().result()
    finally:
        wait([task for task in started if not task.cancel()])


_occupied: list[None] = []  # one for each task of `in_order` that is not done; changes of its length are atomic


def _count_free_threads() -> int:
    """Return the number of threads, including the calling one, without those that perform tasks of `in_order`."""
    return max(compilation.thread_count() - max(len(_occupied) - 1, 0), 1)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Return persistent threads, whose memory is reused."""
    return ThreadPoolExecutor(count, "scenetruth", _limit_threads, (count,))


def _limit_threads(count: int) -> None:
    """Set the number of threads in a new thread, for which numba has a number of its own."""
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


# A forked process has none of the threads of its parent.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
    os.register_at_fork(after_in_child=_occupied.clear)


def bands(count: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of as many bands of rows as threads."""
    parts = max(min(compilation.thread_count(), count), 1)
    return [(count * n // parts, count * (n + 1) // parts) for n in range(parts)]


def with_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return a function whose linear algebra runs in one thread, for many small matrices, or in threads of our own.

    On busy processors, threads of BLAS that wait for each other take several times as long as one.
    """

    @wraps(function)
    def limited(*arguments: _P.args, **named: _P.kwargs) -> _R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return function(*arguments, **named)

    return limited

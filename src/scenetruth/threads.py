"""Parallel execution of tasks and row bands in threads, and linear algebra in a single one."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from scenetruth import compilation

__all__ = ["bands", "in_bands", "in_threads", "with_one_blas_thread"]

_P = ParamSpec("_P")
_R = TypeVar("_R")

# Bands per thread, to balance bands of different cost.
_BANDS = 2


def in_threads(work: Callable[[Any], None], jobs: Iterable[Any]) -> None:
    """Perform all tasks in threads, including the calling thread, and re-raise any exception; calls may be nested."""
    left = deque(jobs)

    def take() -> None:
        while True:
            try:
                job = left.popleft()
            except IndexError:
                return
            work(job)

    helpers = min(compilation.thread_count(), len(left)) - 1
    started = [_pool(compilation.thread_count()).submit(take) for _ in range(helpers)]
    try:
        take()
    finally:
        # All tasks have started, unless this thread was interrupted: then pending tasks are dropped. Pending helpers
        # have nothing to do and are not awaited: all threads may be waiting for tasks of their own.
        left.clear()
        begun = [helper for helper in started if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def in_bands(kernel: Callable[..., None], count: int, *arguments: Any, least: int = 1024) -> None:
    """Call a kernel in threads on bands that cover the indices from 0 to ``count`` - 1 once each.

    ``count``: Number of indices. With 0, the kernel is not called.
    ``least``: Minimum number of indices per call, equivalent to some tens of microseconds.
    """
    threads = compilation.thread_count()
    parts = 1 if threads == 1 else max(min(_BANDS * threads, count // least), 1)
    if parts == 1:
        if count > 0:
            kernel(0, count, *arguments)
        return
    in_threads(
        lambda part: kernel(count * part // parts, count * (part + 1) // parts, *arguments),
        range(parts),
    )


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Return persistent threads, whose memory is reused."""
    return ThreadPoolExecutor(count, thread_name_prefix="scenetruth")


# A forked process has none of the threads of its parent.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def bands(count: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of as many bands of rows as threads."""
    parts = max(min(compilation.thread_count(), count), 1)
    return [(count * n // parts, count * (n + 1) // parts) for n in range(parts)]


def with_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return a function whose linear algebra runs in one thread, for many matrices of a few hundred rows.

    On busy processors, threads of BLAS that wait for each other take several times as long as one.
    """

    @wraps(function)
    def limited(*arguments: _P.args, **named: _P.kwargs) -> _R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return function(*arguments, **named)

    return limited

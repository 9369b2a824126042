"""Sharing work among threads, for kernels that release the interpreter's lock.

numba's own parallel loops compile for seconds longer, and share tiles of unequal cost out beforehand.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any

from scenetruth.compilation import thread_count

__all__ = ["bands", "in_threads"]


def in_threads(work: Callable[[Any], None], jobs: Iterable[Any]) -> None:
    """Do all jobs, each in one of the threads, this one among them; an exception of any is raised."""
    left = deque(jobs)

    def take() -> None:
        while True:
            try:
                job = left.popleft()
            except IndexError:
                return
            work(job)

    helpers = min(thread_count(), len(left)) - 1
    started = [_pool(thread_count()).submit(take) for _ in range(helpers)]
    try:
        take()
    finally:
        # All is done, unless this thread was interrupted: then what has not begun is dropped.
        left.clear()
        wait(started)
    for helper in started:
        helper.result()


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Return threads that stay: their memory is warm when the next work comes."""
    return ThreadPoolExecutor(count, thread_name_prefix="scenetruth")


# A forked process has none of its parent's threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def bands(count: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of as many runs of rows as threads."""
    parts = max(min(thread_count(), count), 1)
    return [(count * n // parts, count * (n + 1) // parts) for n in range(parts)]

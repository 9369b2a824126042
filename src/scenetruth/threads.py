"""Work on bands of rows in threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any

from scenetruth.compilation import thread_count

__all__ = ["bands", "in_bands", "in_threads"]

# Bands per thread: where some cost more than others, the threads still end at about the same time.
_BANDS = 2


def in_threads(work: Callable[[Any], None], jobs: Iterable[Any]) -> None:
    """Do all jobs, each in one of the threads, this one among them; an exception of any is raised.

    Work may itself share its jobs out in this way.
    """
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
        # All is taken, unless this thread was interrupted: then what has not begun is dropped. Helpers that have not
        # begun find nothing to do, and are not waited for: the threads may all wait for work of their own.
        left.clear()
        begun = [helper for helper in started if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def in_bands(kernel: Callable[..., None], count: int, *arguments: Any, least: int = 1024) -> None:
    """Call a kernel on bands of the indices from 0 to ``count`` - 1 that cover each index once, in threads.

    ``count``: Number of indices. With 0, the kernel is not called.
    ``least``: Smallest number of indices that is worth a call in a thread of its own: some tens of microseconds of
      work.
    """
    threads = thread_count()
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
    """Return threads that stay: their memory is warm when the next work comes."""
    return ThreadPoolExecutor(count, thread_name_prefix="scenetruth")


# A forked process has none of its parent's threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def bands(count: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of as many runs of rows as threads."""
    parts = max(min(thread_count(), count), 1)
    return [(count * n // parts, count * (n + 1) // parts) for n in range(parts)]

"""One function of many things, by processes of this machine, its results in the order of the things."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

from scenetruth.dataset.engine.workers import workers_of

__all__ = ["WORTH_S", "in_order"]

WORTH_S = 10.0
"""Work that takes longer than this is worth the start of processes, which takes some seconds."""


def in_order(work: Callable[..., Any], shared: Any, things: Iterable[Any], workers: int = 0) -> Iterator[Any]:
    """Give ``work(shared, thing)`` for each thing.

    Parameters
    ----------
    work
        A function of a module.
    shared
        What every call gets first.
    things
        What each call gets then.
    workers
        Processes of one thread each, where there is work for them; 0 does it here, when it is asked for.

    Raises
    ------
    MachineError
        If no process can be started here.
    """
    left = list(things)
    seconds = 0.0
    # The first call may load or compile; the second tells how long it takes.
    for thing in left[:2] if workers else left:
        start = time.perf_counter()
        yield work(shared, thing)
        seconds = time.perf_counter() - start
    if not workers:
        return
    left = left[2:]
    if seconds * len(left) < WORTH_S:
        yield from (work(shared, thing) for thing in left)
        return
    crew = workers_of(workers)
    try:
        crew.refuse_unfit()
        futures: list[Future[Any]] = [crew.submit(work, shared, thing) for thing in left]
        yield from (future.result() for future in futures)
    finally:
        crew.close()

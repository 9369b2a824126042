"""One function of many things, by processes of this machine, its results in the order of the things."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

from scenetruth.dataset.engine.workers import workers_of

__all__ = ["in_order"]


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
        Processes of one thread each; 0 does the work here, when it is asked for.

    Raises
    ------
    MachineError
        If no process can be started here.
    """
    if workers < 1:
        yield from (work(shared, thing) for thing in things)
        return
    crew = workers_of(workers)
    try:
        crew.refuse_unfit()
        futures: list[Future[Any]] = [crew.submit(work, shared, thing) for thing in things]
        yield from (future.result() for future in futures)
    finally:
        crew.close()

"""One piece of work on every sample that is there, by workers: what fails is told, and the others go on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from scenetruth.dataset.engine.drive import Drive
from scenetruth.dataset.engine.workers import workers_of
from scenetruth.dataset.sample import Made
from scenetruth.progress import Progress

__all__ = ["Each", "for_each"]


@dataclass
class Each:
    """What became of the samples.

    Parameters
    ----------
    done
        How many pieces of work were done.
    present
        How many had been done before.
    failed
        What went wrong, by the number of the sample.
    """

    done: int = 0
    present: int = 0
    failed: dict[int, str] = field(default_factory=dict)


def for_each(
    numbers: Sequence[int],
    work: Callable[..., Made],
    arguments: tuple[Any, ...],
    *,
    present: int = 0,
    workers: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    retries: int = 0,
    what: str = "samples",
    made: Callable[[Made], None] | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Each:
    """Do a piece of work on samples.

    Parameters
    ----------
    numbers
        The samples.
    work, arguments
        Called with the arguments and a number, in some worker; returns `Made`.
    present
        How many samples need no work any more.
    workers, threads, scheduler, retries
        As of `run_dataset`.
    what
        What progress calls the work.
    made
        Called with everything that was made.
    progress
        Called with (what, done, total).
    notice
        Called with lines that a user may want to read.
    """
    found, say = Each(present=present), notice or (lambda _: None)
    total = len(numbers) + present

    def tell() -> None:
        if progress is not None:
            progress(what, found.done + found.present + len(found.failed), total)

    def take(one: Made) -> None:
        found.done += 1
        if made is not None:
            made(one)
        tell()

    def failed(one: Made, attempts: int) -> None:
        message = " ".join(str(one.failure["message"]).split())
        found.failed[one.number] = message
        say(f"sample {one.number} failed: {message}")
        tell()

    crew = workers_of(workers, threads, scheduler)
    try:
        tell()
        Drive(crew, work, arguments, take, failed, say, retries=retries).run(numbers)
        crew.renew()
    finally:
        crew.close()
    return found

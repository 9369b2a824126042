"""Drives many samples through workers: a few at a time, again where a process died, paused where room runs out."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from typing import Any

from scenetruth.dataset.engine import room
from scenetruth.dataset.engine.workers import Workers
from scenetruth.dataset.sample import Made

__all__ = ["Drive"]

_AHEAD = 2
"""Samples per worker that are handed in: one is worked on, one is ready."""
_LOOK_S = 1.0
_DIED = "its process died: killed, out of memory, or a crash of compiled code"


@dataclass
class Drive:
    """Makes samples, each by one call in some worker.

    Parameters
    ----------
    workers
        Who works.
    work
        Makes a sample: called with ``arguments`` and its number, returns `Made`.
    arguments
        What every call gets first.
    retries
        How often a sample that failed is tried again, after all others, in a new process. One that found the disk full
        is tried until there is room.
    recycle
        Samples after which processes of one machine are started anew.
    pause
        Tells why no more samples may be begun now; an empty text if they may.
    made
        Called with every sample that is there.
    failed
        Called with every sample that failed for good.
    said
        Called with lines that a user may want to read.
    """

    workers: Workers
    work: Callable[..., Made]
    arguments: tuple[Any, ...]
    made: Callable[[Made], None]
    failed: Callable[[Made, int], None]
    said: Callable[[str], None]
    pause: Callable[[], str] = lambda: ""
    retries: int = 1
    recycle: int = 500
    _proven: bool = False
    _full_until: float = -1e9

    def run(self, numbers: Iterable[int]) -> None:
        """Make samples; what fails is tried again when all others are done."""
        left: deque[int] = deque(numbers)
        attempts: dict[int, int] = {}
        while left:
            again: list[Made] = []
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

    def _through(self, left: deque[int], again: list[Made]) -> None:
        """Make samples until none is left."""
        under_way: dict[Future[Any], int] = {}
        begun, suspects, paused = 0, list[int](), ""
        while left or under_way or suspects:
            due = begun >= self.recycle * self.workers.count
            if not under_way and (due or suspects):
                self.workers.renew()
                if suspects and not self._proven:
                    self.workers.refuse_unfit()
                # All that were under way died with one of them: who it was shows when each is alone.
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
                    continue
            if not under_way:
                time.sleep(_LOOK_S)
                continue
            done, _ = wait(under_way, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            for future in done:
                number = under_way.pop(future)
                try:
                    self._take(future.result(), again)
                except self.workers.lost:
                    suspects.append(number)
                except CancelledError:
                    self.workers.refuse_unfit()
                    suspects.append(number)

    def _by_itself(self, number: int, again: list[Made]) -> None:
        """Make one sample with nothing else under way: if a process dies now, it is this sample's."""
        future = self.workers.submit(self.work, *self.arguments, number)
        while True:
            done, _ = wait([future], timeout=_LOOK_S)
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

    def _take(self, found: Made, again: list[Made]) -> None:
        self._proven = True
        if found.disk_full:
            self._full_until = time.monotonic() + room.FULL_S
        if found.failure:
            again.append(found)
        else:
            self.made(found)

    def _told_pause(self, before: str) -> str:
        """Return why nothing may be begun now, and tell when that changes."""
        reason = self.pause()
        if not reason and time.monotonic() < self._full_until:
            reason = "the disk is full: a sample could not be written; free some, it goes on by itself"
        if reason and not before:
            self.said(f"paused: {reason}")
        elif before and not reason:
            self.said("goes on")
        return reason


def _died(number: int) -> Made:
    return Made(number, failure={"sample": number, "error": "WorkerDied", "message": _DIED})

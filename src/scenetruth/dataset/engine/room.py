"""Whether there is room for another sample, on the disk and in memory, and patience where there is none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scenetruth.errors import ScenetruthError
from scenetruth.placing import is_full_disk
from scenetruth.resources.machine import free_disk_bytes, free_memory_bytes

__all__ = ["FULL_S", "Room", "patiently"]

_LOOK_S = 2.0
FULL_S = 5.0
"""Seconds until something is written again that found the disk full."""
_SPARE_BYTES = 200e6
"""What is left alone on the disk."""


@dataclass
class Room:
    """Tells whether another sample may be begun.

    Parameters
    ----------
    folder
        Where samples go.
    disk_bytes
        What the samples that are under way may take.
    memory_bytes
        What one sample takes.
    """

    folder: Path
    disk_bytes: float
    memory_bytes: float
    _looked: float = -1e9
    _reason: str = ""

    def __call__(self) -> str:
        """Return why no sample may be begun now; an empty text if one may."""
        if time.monotonic() - self._looked > _LOOK_S:
            self._looked, self._reason = time.monotonic(), self._look()
        return self._reason

    def _look(self) -> str:
        disk, memory = free_disk_bytes(self.folder), free_memory_bytes()
        wanted = self.disk_bytes + _SPARE_BYTES
        if disk is not None and disk < wanted:
            return (
                f"the disk is nearly full: {disk / 1e6:,.0f} MB are free, {wanted / 1e6:,.0f} are needed; "
                "free some, it goes on by itself; or interrupt, and run it again later"
            )
        if memory is not None and memory < self.memory_bytes:
            return (
                f"memory is short: {memory / 1e6:,.0f} MB are free, a sample takes {self.memory_bytes / 1e6:,.0f}; "
                "it goes on by itself when there is more; or interrupt, and run it again with fewer workers"
            )
        return ""


def patiently(write: Callable[[], None], what: str, say: Callable[[str], None]) -> None:
    """Write, and where the disk is full, try again until it is not.

    Parameters
    ----------
    write
        Writes a file whole, or leaves nothing.
    what
        What it is, for the line that says so.
    say
        Called with that line.
    """
    told = False
    while True:
        try:
            write()
        except (OSError, ScenetruthError) as error:
            if not is_full_disk(error):
                raise
            if not told:
                say(f"paused: the disk is full, {what} waits to be written; free some, it goes on by itself")
            told = True
            time.sleep(FULL_S)
        else:
            if told:
                say("goes on")
            return

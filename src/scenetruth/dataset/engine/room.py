"""Whether there is room for another sample: disk and memory, looked at now and then while a data set is made."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from scenetruth.resources.machine import free_disk_bytes, free_memory_bytes

__all__ = ["Room"]

_LOOK_S = 2.0
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

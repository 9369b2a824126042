"""How much memory something takes, looked at now and then while it runs."""

from __future__ import annotations

import math
import os
import threading
from pathlib import Path
from types import TracebackType

__all__ = ["PeakMemory"]

_STATM = Path("/proc/self/statm")
_LOOK_S = 0.01


class PeakMemory:
    """Context that finds how much more memory this process has at most than when it began.

    Where the system does not tell (`/proc`), ``megabytes`` is NaN. What is allocated and freed within 10 ms is not
    seen.
    """

    def __init__(self) -> None:
        self.megabytes = math.nan
        self._over = threading.Event()

    def __enter__(self) -> PeakMemory:
        before = _resident_bytes()
        if before is None:
            return self
        self.megabytes = 0.0
        self._thread = threading.Thread(target=self._look, args=(before,), name="memory", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()
        if not math.isnan(self.megabytes):
            self._thread.join()

    def _look(self, before: int) -> None:
        over = False
        while not over:
            over = self._over.wait(_LOOK_S)
            now = _resident_bytes() or before
            self.megabytes = max(self.megabytes, (now - before) / 1e6)


def _resident_bytes() -> int | None:
    try:
        pages = int(_STATM.read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")

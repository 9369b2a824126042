"""Who writes: names of half-written results tell their process, so that those of dead processes can be swept."""

from __future__ import annotations

import hashlib
import os
import re
import socket
from dataclasses import dataclass
from functools import cache
from pathlib import Path

__all__ = ["Writer", "this_writer", "written_by"]


@dataclass(frozen=True)
class Writer:
    """A process on a machine.

    Parameters
    ----------
    host
        Eight digits that stand for the machine's name.
    process
        Number of the process.
    start
        When it started, in clock ticks since the machine did; a number may be given to another process later.

    Examples
    --------
    >>> writer = Writer("0123abcd", 17, 4711)
    >>> written_by(f".cube.partial-{writer}") == (".cube.partial", writer)
    True
    """

    host: str
    process: int
    start: int

    def __str__(self) -> str:
        return f"{self.host}-{self.process}-{self.start}"

    @property
    def is_dead(self) -> bool:
        """Whether the process has ended; of another machine's process, nobody here can tell: False."""
        return self.host == _host() and _start_of(self.process) != self.start


def this_writer() -> Writer:
    """Return the process that asks."""
    return Writer(_host(), os.getpid(), _start_of(os.getpid()))


def written_by(name: str) -> tuple[str, Writer] | None:
    """Return the first part of a file's name and the writer that the rest of it tells; None if it tells none."""
    found = _NAME.fullmatch(name)
    return None if found is None else (found[1], Writer(found[2], int(found[3]), int(found[4])))


_NAME = re.compile(r"(.+)-([0-9a-f]{8})-([0-9]+)-([0-9]+)", re.DOTALL)


@cache
def _host() -> str:
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]


def _start_of(process: int) -> int:
    """Return when a process started, 0 where the system does not tell, -1 if there is no such process."""
    try:
        # Its second word, the name of the program, may hold spaces and brackets.
        words = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return -1 if Path("/proc/self/stat").exists() or not _is_alive(process) else 0
    # A process that has ended and was not yet asked for its result still has an entry.
    return -1 if words[0] == "Z" else int(words[19])


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True

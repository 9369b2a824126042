"""All processes that a program has started: their memory, and their end."""

from __future__ import annotations

import os
import secrets
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

__all__ = ["MARK", "ProcessTree", "can_be_seen", "new_mark"]

MARK = "SCENETRUTH_PROGRAM"
"""Environment variable by which the processes of a program are known, whoever their parent is by now."""

_PROCESSES = Path("/proc")
_KILL_S = 5.0
_DEAD = ("Z", "X")


def can_be_seen() -> bool:
    """Tell whether this machine tells of its processes."""
    return (_PROCESSES / "self" / "stat").is_file()


def new_mark() -> str:
    """Return a value of `MARK` that nobody else has."""
    return secrets.token_hex(8)


class ProcessTree:
    """A process that leads a session of its own, and all that it and its children start.

    To it belong the processes of its group and its session, the children of all that have been seen, and, when all are
    ended, those that have inherited its mark.

    Parameters
    ----------
    leader
        Id of the process; it must not be waited for as long as this is in use, so that the id stays its own.
    mark
        What its environment says of `MARK`.
    """

    def __init__(self, leader: int, mark: str) -> None:
        self._leader = leader
        self._mark = f"{MARK}={mark}".encode()
        # When each was started, in the machine's clock: ids are used again.
        self._seen: dict[int, str] = {}

    def look(self) -> set[int]:
        """Return the ids of all that are alive."""
        found = _table()
        own = str(self._leader)
        members = {
            pid
            for pid, (_, _, group, session, started) in found.items()
            if own in (group, session) or self._seen.get(pid) == started
        }
        children: dict[str, list[int]] = {}
        for pid, (_, parent, *_) in found.items():
            children.setdefault(parent, []).append(pid)
        open_ = list(members)
        while open_:
            for pid in children.get(str(open_.pop()), ()):
                if pid not in members:
                    members.add(pid)
                    open_.append(pid)
        self._seen |= {pid: found[pid][4] for pid in members}
        return {pid for pid in members if found[pid][0] not in _DEAD}

    def memory_mb(self) -> float:
        """Return the resident memory of all together in MB (1e6 bytes); what they share counts once."""
        return sum(map(_resident_bytes, self.look())) / 1e6

    def kill(self) -> None:
        """End all of them; return when they are dead, or cannot be ended within some seconds."""
        until = time.monotonic() + _KILL_S
        while True:
            alive = self.look() | self._marked()
            # The group is ended in one go: nobody in it can start another one meanwhile.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._leader, signal.SIGKILL)
            for pid in alive:
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            if not alive or time.monotonic() > until:
                return
            time.sleep(0.005)

    def _marked(self) -> set[int]:
        """Return the ids of those that have inherited the mark; the dead tell of none."""
        found = set()
        for pid in _ids():
            with suppress(OSError):  # it has ended meanwhile, or is another user's
                if self._mark in (_PROCESSES / str(pid) / "environ").read_bytes().split(b"\0"):
                    found.add(pid)
        return found


def _ids() -> Iterator[int]:
    with suppress(FileNotFoundError):
        yield from (int(name) for name in os.listdir(_PROCESSES) if name.isdigit())


def _table() -> dict[int, tuple[str, str, str, str, str]]:
    """Return state, parent, group, session and start of every process."""
    found = {}
    for pid in _ids():
        try:
            text = (_PROCESSES / str(pid) / "stat").read_text(encoding="ascii", errors="replace")
        except OSError:  # it has ended meanwhile
            continue
        # The name of the program, in brackets, may hold anything.
        rest = text.rpartition(")")[2].split()
        found[pid] = (rest[0], rest[1], rest[2], rest[3], rest[19])
    return found


def _resident_bytes(pid: int) -> int:
    """Return the memory of a process, of what it shares its part; 0 of one that has ended."""
    folder = _PROCESSES / str(pid)
    try:
        for line in (folder / "smaps_rollup").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    try:
        # Kernels that do not tell shares: all that is resident.
        return int((folder / "statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0

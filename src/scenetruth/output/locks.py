"""Locks on results, and the identity of the writing process in names of temporary files."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from scenetruth.errors import OutputExistsError

__all__ = ["Writer", "locked", "this_writer", "written_by"]


@dataclass(frozen=True)
class Writer:
    """A process: host-name hash of eight digits, ID, and start in clock ticks since boot, because IDs are reused.

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
        """Whether the process has ended; False for processes of other machines."""
        return self.host == _host() and _read_start_time(self.process) != self.start


def this_writer() -> Writer:
    """Return the current process."""
    return Writer(_host(), os.getpid(), _read_start_time(os.getpid()))


def written_by(name: str) -> tuple[str, Writer] | None:
    """Return the stem of a temporary file's name and the writer encoded in it; None if there is none."""
    found = _NAME.fullmatch(name)
    return None if found is None else (found[1], Writer(found[2], int(found[3]), int(found[4])))


_NAME = re.compile(r"(.+)-([0-9a-f]{8})-([0-9]+)-([0-9]+)", re.DOTALL)


@cache
def _host() -> str:
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]


def _read_start_time(process: int) -> int:
    """Return the start time of a process, 0 where unavailable, -1 if there is no such process."""
    try:
        # The second field, the name of the program, may contain spaces and parentheses.
        words = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return -1 if Path("/proc/self/stat").exists() or not _is_alive(process) else 0
    # A zombie process still has an entry.
    return -1 if words[0] == "Z" else int(words[19])


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


_held: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())
_TAKEN = (errno.EWOULDBLOCK, errno.EACCES, errno.EAGAIN)


def lock_path(target: Path) -> Path:
    """Return the lock file of a target."""
    return target.with_name(f".{target.name}.lock")


@contextmanager
def locked(target: Path) -> Iterator[bool]:
    """Lock a target against other writers while the block runs; reentrant within a process.

    The lock ends with the process that holds it. File systems without locks provide no protection.
    """
    if target in _held.get():
        yield True
        return
    handle = _acquire(target)
    token = _held.set(_held.get() | {target})
    try:
        yield handle is not None
    finally:
        _held.reset(token)
        if handle is not None:
            try:
                # Removed while still locked: another process that has opened it detects the removal.
                with contextlib.suppress(OSError):
                    lock_path(target).unlink()
            finally:
                os.close(handle)


def _acquire(target: Path) -> int | None:
    lock = lock_path(target)
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:
            # A path that cannot be locked cannot be written either; the write reports the reason.
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_same(handle, lock):
                os.ftruncate(handle, 0)
                os.write(handle, f"{os.getpid()}\n".encode())
                return handle
        except OSError as error:
            holder = _holder(handle)
            os.close(handle)
            if error.errno not in _TAKEN:
                return None
            message = f"is being written by another run{holder}; wait until it has ended, or specify another output"
            raise OutputExistsError(target, message) from error
        # The former holder removed the file between opening and locking.
        os.close(handle)


def _is_same(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _holder(handle: int) -> str:
    try:
        number = os.pread(handle, 20, 0).decode().strip()
    except (OSError, UnicodeDecodeError):
        return ""
    return f" (process {number})" if number.isdecimal() else ""

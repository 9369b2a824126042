"""One writer at a time: a lock beside every result, which ends with its process."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from scenetruth.errors import OutputExistsError

__all__ = ["lock_of", "locked"]

_held: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())
_TAKEN = (errno.EWOULDBLOCK, errno.EACCES, errno.EAGAIN)


def lock_of(target: Path) -> Path:
    """Return the file that is locked while a target is written."""
    return target.with_name(f".{target.name}.lock")


@contextmanager
def locked(target: Path) -> Iterator[bool]:
    """Keep every other writer of a target away while the block runs; whoever has it already keeps it.

    The lock ends with the process that holds it, however that ends. Where the file system has no locks, nobody is kept
    away.

    Parameters
    ----------
    target
        Absolute path of the file or folder that is to be written.

    Yields
    ------
    bool
        Whether the target is locked.

    Raises
    ------
    OutputExistsError
        If another writer has it.
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
                # Removed while it is still locked: whoever opened it meanwhile finds that it is no longer there.
                with contextlib.suppress(OSError):
                    lock_of(target).unlink()
            finally:
                os.close(handle)


def _acquire(target: Path) -> int | None:
    lock = lock_of(target)
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:
            # What cannot be locked here cannot be written here either, and the writing tells why.
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
            message = f"is being written by another run{holder}; wait until it has ended, or give another output"
            raise OutputExistsError(target, message) from error
        # The former holder has removed it between our opening and locking it.
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

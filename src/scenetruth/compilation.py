"""Numba compilation: location of the cache, and number of threads."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from scenetruth.errors import MachineError, Problem

__all__ = ["announced_compilation", "check_environment", "keep_compiled_code", "thread_count"]

_LAYERS = ("default", "safe", "forksafe", "threadsafe", "tbb", "omp", "workqueue")


def keep_compiled_code() -> None:
    """Let numba cache compiled code in a temporary directory if no other location is writable.

    The default locations are next to the modules or in the user's cache; without a writable location, as in a shared
    installation without home directory, numba raises an error.
    """
    if "NUMBA_CACHE_DIR" in os.environ or os.access(Path(__file__).parent, os.W_OK):
        return
    if _can_be_made(_user_cache()):
        return
    folder = _private_folder()
    if folder is not None:
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if "numba" in sys.modules:
            sys.modules["numba"].config.CACHE_DIR = str(folder)


def _user_cache() -> Path:
    given = os.environ.get("XDG_CACHE_HOME")
    return Path(given) / "numba" if given else Path(os.path.expanduser("~")) / ".cache" / "numba"


def _can_be_made(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _private_folder() -> Path | None:
    """Return a directory that is writable for this user only, or None."""
    owner = os.getuid()
    try:
        folder = Path(tempfile.gettempdir()) / f"scenetruth-{owner}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    safe = stat.S_ISDIR(found.st_mode) and found.st_uid == owner and not found.st_mode & 0o077
    return folder if safe and os.access(folder, os.W_OK) else None


def check_environment() -> None:
    """Raise if environment variables are invalid for numba."""
    problems = []
    threads = os.environ.get("NUMBA_NUM_THREADS")
    if threads is not None and not (threads.isascii() and threads.strip().isdigit() and int(threads) > 0):
        problems.append(Problem("NUMBA_NUM_THREADS", "must be a positive integer; correct it, or unset it", threads))
    layer = os.environ.get("NUMBA_THREADING_LAYER")
    if layer is not None and layer not in _LAYERS:
        message = f"must be one of {', '.join(_LAYERS)}; correct it, or unset it"
        problems.append(Problem("NUMBA_THREADING_LAYER", message, layer))
    if problems:
        raise MachineError(problems)


@contextmanager
def announced_compilation(announce: Callable[[str, int], None]) -> Iterator[None]:
    """Announce every kernel that is compiled while the block runs, except those loaded from the cache."""
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        begun = 0

        def on_start(self, event: object) -> None:
            announce(event.data["dispatcher"].py_func.__name__, self.begun)  # type: ignore[attr-defined]
            self.begun += 1

        def on_end(self, event: object) -> None:
            pass

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)


def thread_count() -> int:
    """Return the number of threads: NUMBA_NUM_THREADS, or the number of processors; does not import numba."""
    if "numba" in sys.modules:
        import numba

        return int(numba.get_num_threads())
    given = os.environ.get("NUMBA_NUM_THREADS", "")
    return int(given) if given.isdecimal() and int(given) > 0 else os.cpu_count() or 1

"""Atomic writes: a result appears under its name when it is complete; until then an earlier result remains."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from scenetruth.errors import OutputExistsError, StoreError
from scenetruth.output.destinations import check_destination, check_writable
from scenetruth.output.locks import locked, this_writer, written_by
from scenetruth.output.ownership import Claim, OwnershipResult, claim_file

__all__ = [
    "check_output",
    "exchange",
    "is_full_disk",
    "lock_output",
    "remove_leftovers",
    "scratch_path",
    "write_atomically",
]


_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_CANNOT = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EPERM)


def exchange(one: Path, other: Path) -> bool:
    """Exchange two files or directories of one file system atomically; neither name is ever missing."""
    function = _renameat2()
    if function is None:
        return False
    if function(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANNOT:
        return False
    raise OSError(number, os.strerror(number), str(one), None, str(other))


@cache
def _renameat2() -> Any:
    try:
        function = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return None
    function.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint)
    return function


_QUIET_S, _PATIENCE_S = 0.25, 10.0
# Paths with these names are never the only copy: those of dead writers are removed without a check.
_DISPOSABLE = (".partial", ".scratch", ".retired")


@contextmanager
def write_atomically(target: str | Path, *, overwrite: bool = False, claim: Claim = claim_file) -> Iterator[Path]:
    """Yield a temporary path next to the target; it replaces the target on success, and is removed on failure.

    If the process is killed, the target is complete: the new or the earlier result. Where the file system lacks an
    atomic exchange, the next writer restores the earlier result.
    """
    place = check_destination(target)
    with lock_output(place, claim):
        _refuse_existing(place, overwrite, claim)
        partial = _temporary_path(place, "partial")
        try:
            try:
                _remove(partial)
                # Only an attempt shows whether the path is writable.
                partial.touch()
                partial.unlink()
                yield partial
                _put(place, partial, claim)
            except BaseException:
                _clear_up(partial)
                raise
        except OSError as error:
            raise StoreError(place, _explain(error)) from error


@contextmanager
def lock_output(target: str | Path, claim: Claim = claim_file) -> Iterator[None]:
    """Lock a target while the block runs, and remove incomplete output of dead writers."""
    place = Path(os.path.realpath(target))
    if not place.name:
        # The root directory has no siblings and cannot be replaced.
        yield
        return
    made = _make_folders(place)
    try:
        with locked(place) as alone:
            if alone:
                _remove_stale(place, claim)
            yield
    except BaseException:
        _remove_empty(made)
        raise


def scratch_path(partial: Path) -> Path:
    """Return another temporary path next to that of `write_atomically`; it is cleaned up in the same manner."""
    return (
        partial.with_name(partial.name.replace(".partial-", ".scratch-"))
        if ".partial-" in partial.name
        else (partial.with_name(f".{partial.name}.scratch-{this_writer()}"))
    )


def check_output(target: str | Path, *, overwrite: bool = False, claim: Claim = claim_file) -> None:
    """Raise, before any work, if `write_atomically` would reject a target."""
    place = check_destination(target)
    if not place.exists():
        check_writable(target)
    _refuse_existing(place, overwrite, claim)


def _refuse_existing(place: Path, overwrite: bool, claim: Claim) -> None:
    if not place.exists() or _is_empty(place):
        return
    if not overwrite:
        raise OutputExistsError(place)
    refusal = claim(place).refusal
    if refusal:
        raise OutputExistsError(place, f"{refusal}; only results of scenetruth are replaced")


def _remove_stale(place: Path, claim: Claim = claim_file) -> None:
    own = this_writer()
    for path in _leftovers(place):
        found = written_by(path.name)
        if found is None or not (found[1].is_dead or found[1] == own):
            continue
        if found[0].endswith(_DISPOSABLE):
            _remove(path)
        elif place.exists():
            _retire(path, place, claim)
        else:
            path.rename(place)


def remove_leftovers(folder: Path, claim: Claim = claim_file) -> None:
    """Remove incomplete output of dead writers of every target in a directory."""
    places = set()
    for path in folder.glob(".*"):
        found = written_by(path.name)
        if found is not None and found[0].endswith((*_DISPOSABLE, ".replaced")):
            places.add(folder / found[0].rpartition(".")[0].removeprefix("."))
        elif path.name.endswith(".lock"):
            places.add(folder / path.name.removeprefix(".").removesuffix(".lock"))
    for place in places:
        with contextlib.suppress(OutputExistsError), locked(place) as alone:
            if alone:
                _remove_stale(place, claim)


def _leftovers(place: Path) -> list[Path]:
    starts = tuple(f".{place.name}.{what}-" for what in ("partial", "scratch", "retired", "replaced"))
    return sorted(path for path in place.parent.iterdir() if path.name.startswith(starts))


def _temporary_path(place: Path, what: str) -> Path:
    return place.with_name(f".{place.name}.{what}-{this_writer()}")


def _put(place: Path, new: Path, claim: Claim) -> None:
    if not place.is_dir() and not new.is_dir():
        os.replace(new, place)
        return
    if not place.exists():
        new.rename(place)
        return
    # From here on, the path with this name is never the only copy of its content.
    waiting = _temporary_path(place, "replaced")
    new.rename(waiting)
    if not exchange(waiting, place):
        waiting.rename(new)
        place.rename(waiting)
        new.rename(place)
    _retire(waiting, place, claim)


def _retire(old: Path, place: Path, claim: Claim) -> None:
    """Remove an earlier result; foreign files in it are moved to the new result."""
    claimed = OwnershipResult() if _is_empty(old) else claim(old)
    if claimed.refusal:
        return
    if not old.is_dir():
        old.unlink()
        return
    for name in claimed.foreign:
        if not os.path.lexists(place / name):
            (old / name).rename(place / name)
    # A partly removed result could not be identified: it is renamed first.
    retired = _temporary_path(place, "retired")
    _remove(retired)
    if not any(os.path.lexists(old / name) for name in claimed.foreign):
        old.rename(retired)
    else:
        retired.mkdir()
        for entry in list(old.iterdir()):
            if entry.name not in claimed.foreign:
                entry.rename(retired / entry.name)
    _remove(retired)


def _is_empty(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _make_folders(place: Path) -> list[Path]:
    """Create the directories above a target; return the new directories, the innermost first."""
    missing = [folder for folder in place.parents if not folder.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _remove_empty(missing)
        raise StoreError(place, _explain(error)) from error
    return missing


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _clear_up(path: Path) -> None:
    """Remove output of a failed writer until it stays absent: threads of zarr may write chunks after the error."""
    quiet_since = time.monotonic()
    deadline = quiet_since + _PATIENCE_S
    while time.monotonic() < min(quiet_since + _QUIET_S, deadline):
        if os.path.lexists(path):
            with contextlib.suppress(OSError):
                _remove(path)
            quiet_since = time.monotonic()
        time.sleep(0.01)


def is_full_disk(error: BaseException | None) -> bool:
    """Return whether an error, or one of its causes, reports a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


_FULL = (errno.ENOSPC, errno.EDQUOT)


def _explain(error: OSError) -> str:
    if is_full_disk(error):
        return "the disk is full; nothing was written. Free some space or choose another output"
    return f"cannot be written: {error.strerror or error}; nothing was written"

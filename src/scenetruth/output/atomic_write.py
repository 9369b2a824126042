"""Atomic writes: a result appears under its name only when it is complete; an earlier result stays until then."""

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
from scenetruth.output.destinations import check_destination
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
    """Let two files or folders of one file system change places; nobody ever finds one of the names missing."""
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
# What goes by these names is never the only copy of anything: dead writers' are removed as they are.
_DISPOSABLE = (".partial", ".scratch", ".retired")


@contextmanager
def write_atomically(target: str | Path, *, overwrite: bool = False, claim: Claim = claim_file) -> Iterator[Path]:
    """Give a path beside the target to write to; it becomes the target when all went well, and vanishes otherwise.

    Whatever moment the process is killed at, the target is whole afterwards: the new one, or the earlier one, which
    the next writer restores where the file system cannot exchange two names in one step.
    """
    place = check_destination(target)
    with lock_output(place, claim):
        _refuse_existing(place, overwrite, claim)
        aside = _temporary_path(place, "partial")
        try:
            try:
                _remove(aside)
                # Whether anything can be made here is known only when it has been.
                aside.mkdir()
                aside.rmdir()
                yield aside
                _put(place, aside, claim)
            except BaseException:
                _clear_up(aside)
                raise
        except OSError as error:
            raise StoreError(place, _explain(error)) from error


@contextmanager
def lock_output(target: str | Path, claim: Claim = claim_file) -> Iterator[None]:
    """Keep other writers away from a target while the block runs, and put away what dead ones have left."""
    place = Path(os.path.realpath(target))
    if not place.name:
        # Nothing stands beside the root, and nothing takes its place.
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


def scratch_path(aside: Path) -> Path:
    """Return one more path beside what `write_atomically` gave, for what does not stay; it is swept like that one."""
    return (
        aside.with_name(aside.name.replace(".partial-", ".scratch-"))
        if ".partial-" in aside.name
        else (aside.with_name(f".{aside.name}.scratch-{this_writer()}"))
    )


def check_output(target: str | Path, *, overwrite: bool = False, claim: Claim = claim_file) -> None:
    """Refuse, before any work, a target that `write_atomically` would refuse."""
    _refuse_existing(check_destination(target), overwrite, claim)


def _refuse_existing(place: Path, overwrite: bool, claim: Claim) -> None:
    if not place.exists() or _is_empty(place):
        return
    if not overwrite:
        raise OutputExistsError(place)
    refusal = claim(place).refusal
    if refusal:
        raise OutputExistsError(place, f"{refusal}; only results of scenetruth are replaced")


def _remove_stale(place: Path, claim: Claim = claim_file) -> None:
    """Put away what dead writers of a target left, and restore the earlier result if they left that."""
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
    """Put away what dead writers left of every target in a folder."""
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
    # From here on, what stands under this name is never the only copy of anything but what it is replaced by.
    waiting = _temporary_path(place, "replaced")
    new.rename(waiting)
    if not exchange(waiting, place):
        waiting.rename(new)
        place.rename(waiting)
        new.rename(place)
    _retire(waiting, place, claim)


def _retire(old: Path, place: Path, claim: Claim) -> None:
    """Remove an earlier result; what is not ours in it goes to the result that took its place."""
    claimed = OwnershipResult() if _is_empty(old) else claim(old)
    if claimed.refusal:
        return
    if not old.is_dir():
        old.unlink()
        return
    for name in claimed.foreign:
        if not os.path.lexists(place / name):
            (old / name).rename(place / name)
    # Of a result that is removed in part, nobody could tell any more that it was one: it gets another name first.
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
    """Make the folders above a target; return those that were not there, the innermost first."""
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
    """Remove what a failed or interrupted writer left.

    zarr writes in threads of its own, which may finish a chunk after the error has reached us: the path must stay away
    for a while before it counts as removed.
    """
    quiet_since = time.monotonic()
    deadline = quiet_since + _PATIENCE_S
    while time.monotonic() < min(quiet_since + _QUIET_S, deadline):
        if os.path.lexists(path):
            with contextlib.suppress(OSError):
                _remove(path)
            quiet_since = time.monotonic()
        time.sleep(0.01)


def is_full_disk(error: BaseException | None) -> bool:
    """Return whether an error, or one that it comes from, says that there is no room left to write to."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


_FULL = (errno.ENOSPC, errno.EDQUOT)


def _explain(error: OSError) -> str:
    if is_full_disk(error):
        return "the disk is full; nothing was kept. Free some space or choose another output"
    return f"cannot be written: {error.strerror or error}; nothing was kept"

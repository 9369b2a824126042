"""Checks that a result can be written to a path, before any work."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from scenetruth.errors import StoreError
from scenetruth.output.locks import this_writer

__all__ = ["check_destination", "check_writable"]

_NAME_BYTES = 255
_FULL = (errno.ENOSPC, errno.EDQUOT)


def check_destination(target: str | Path) -> Path:
    """Return the absolute path of a target, with links resolved."""
    shown = Path(target)
    try:
        given = Path(os.path.abspath(shown))
        place = Path(os.path.realpath(given))
        dangling = given.is_symlink() and not place.exists()
    except (OSError, ValueError) as error:
        raise StoreError(repr(str(target)), f"is not a valid output path: {error}; specify another output") from error
    if dangling:
        raise StoreError(shown, f"is a link to {os.readlink(given)}, which does not exist; remove or repair the link")
    _refuse_name(shown, place)
    _refuse_position(shown, place)
    _refuse_parent(shown, place)
    return place


def check_writable(target: str | Path) -> None:
    """Raise if a directory does not exist and cannot be created, or exists and cannot be written to."""
    shown = Path(target)
    try:
        place = Path(os.path.realpath(shown))
        exists = os.path.lexists(place)
    except (OSError, ValueError) as error:
        raise StoreError(repr(str(target)), f"is not a valid output path: {error}; specify another output") from error
    if exists:
        if not place.is_dir():
            raise StoreError(shown, "exists, and is not a directory; specify another output")
        if not os.access(place, os.W_OK | os.X_OK):
            raise StoreError(shown, "is a directory that is not writable; specify another output")
        return
    _refuse_name(shown, place)
    folder = _refuse_parent(shown, place)
    try:
        # Virtual file systems reject directories whatever the permissions are.
        with tempfile.TemporaryDirectory(prefix=".scenetruth-", dir=folder):
            pass
    except OSError as error:
        if error.errno in _FULL:
            return
        message = f"cannot be written: no directory can be created in {folder} ({error.strerror or error})"
        raise StoreError(shown, f"{message}; specify another output") from error


def _refuse_name(shown: Path, place: Path) -> None:
    # During writing, a sibling with a longer name exists.
    longest = _NAME_BYTES - len(f"..replaced-{this_writer()}")
    length = len(os.fsencode(place.name))
    if length > longest:
        message = f"has a name of {length} bytes, {length - longest} more than the maximum; specify a shorter name"
        raise StoreError(shown, message)


def _refuse_position(shown: Path, place: Path) -> None:
    remedy = "specify a subdirectory"
    if not place.name or os.path.ismount(place):
        raise StoreError(shown, f"is the root of a file system, and cannot be replaced; {remedy}")
    here = Path(os.path.realpath(os.curdir))
    if place == here or place in here.parents:
        raise StoreError(shown, f"is the current directory, or contains it; {remedy}, or change the directory")


def _refuse_parent(shown: Path, place: Path) -> Path:
    """Return the nearest existing directory above a target."""
    for folder in place.parents:
        if not os.path.lexists(folder):
            continue
        if not folder.is_dir():
            raise StoreError(shown, f"cannot be created, because {folder} is not a directory; specify another output")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise StoreError(shown, f"cannot be created, because {folder} is not writable; specify another output")
        return folder
    return Path(place.anchor)

"""Code that a process runs: its program, its libraries and the scripts that it was started with, as Linux lists them.

What a process has written itself is not part of it: files that are newer than the run, those of caches, and those in
the folder of temporary files, unless the user's code is there as well.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from scenetruth.estimators.code_dependencies import is_binary, is_cached, is_code, is_system
from scenetruth.estimators.user_code import is_user_file

__all__ = ["compute_hashes", "have_changed", "list_process_code"]

_PROCESSES = Path("/proc")
_REPLACED = " (deleted)"
# Contents of larger files are represented by size and time of change.
_LARGEST_READ = 64_000_000


def list_process_code(process: int | str = "self") -> set[Path]:
    """Return the user's libraries, programs and scripts that a process runs; empty on other systems than Linux.

    The name of a file that was replaced meanwhile ends in " (deleted)".
    """
    folder = _PROCESSES / str(process)
    names = set[str]()
    with suppress(OSError):  # it has ended
        lines = (folder / "maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
        # Only code is mapped as executable; memory maps of data are not.
        mapped = [parts for line in lines if len(parts := line.split(maxsplit=5)) == 6]
        names.update(parts[5] for parts in mapped if "x" in parts[1])
    # A file that was replaced while it is in use is listed as deleted; the process runs the old one.
    plain = {name: name.removesuffix(_REPLACED) for name in names if name.startswith("/")}
    found = {Path(name) for name, file in plain.items() if _is_followed(file) and is_binary(Path(file))}
    if process != "self":
        found.update(_list_scripts(folder))
    return found


def _list_scripts(folder: Path) -> set[Path]:
    """Return the scripts and programs in the command line of a process."""
    try:
        words = (folder / "cmdline").read_bytes().split(b"\0")
        place = os.readlink(folder / "cwd")
    except OSError:  # it has ended
        return set()
    named = {os.path.realpath(os.path.join(place, os.fsdecode(word))) for word in words if word}
    return {Path(name) for name in named if os.path.isfile(name) and _is_followed(name) and is_code(Path(name))}


@lru_cache(maxsize=4096)
def _is_followed(name: str) -> bool:
    return not is_system(name) and not is_cached(name) and is_user_file(name)


def compute_hashes(files: Iterable[Path], started: float, own: Iterable[Path] = ()) -> dict[str, str]:
    """Return the hash of the contents of every file by its path, except of by-products of the run.

    ``started``: Time at which the run began, in s as by ``time.time``: later files were written by it.
    ``own``: Files of the user's code; if one of them is a temporary file, other temporary files count as well.
    """
    scratch = Path(tempfile.gettempdir()).resolve()
    has_scratch = any(file.is_relative_to(scratch) for file in own)
    found = {}
    for file in sorted(files):
        if file.name.endswith(_REPLACED):
            # The results are those of contents that no longer exist: they are never reused.
            found[str(file)] = "replaced"
            continue
        with suppress(OSError):  # gone: it was a by-product
            is_new = file.stat().st_mtime > started
            if not is_new and (has_scratch or not file.is_relative_to(scratch)):
                found[str(file)] = _compute_hash(str(file))
    return {name: text for name, text in found.items() if text}


def have_changed(hashes: Mapping[str, str]) -> bool:
    """Return whether the contents of any file differ from its hash, or a file is missing."""
    return any(_compute_hash(name) != text for name, text in hashes.items())


def _compute_hash(name: str) -> str:
    try:
        state = os.stat(name)
        return _hash_of_state(name, state.st_mtime_ns, state.st_size, state.st_ino)
    except OSError:
        return ""


@lru_cache(maxsize=4096)
def _hash_of_state(name: str, *state: int) -> str:
    if state[1] > _LARGEST_READ:
        return f"{state[1]} bytes, {state[0]} ns"
    with open(name, "rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()[:16]

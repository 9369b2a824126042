"""Files that a process has opened for reading or mapped into its memory, as Linux lists them under /proc."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from scenetruth.estimators.user_code import is_user_file

__all__ = ["compute_hashes", "have_changed", "list_process_files"]

_PROCESSES = Path("/proc")
# Files of the operating system are those of an installation, as packages are.
_SYSTEM = ("/usr/lib", "/usr/share", "/usr/libexec", "/lib", "/proc", "/sys", "/dev", "/etc", "/run", "/var")
_ACCESS = os.O_WRONLY | os.O_RDWR


def list_process_files(process: int | str = "self") -> set[Path]:
    """Return the user's files that a process has mapped or opened for reading; empty on other systems than Linux."""
    folder = _PROCESSES / str(process)
    names = set[str]()
    with suppress(OSError):  # it has ended
        lines = (folder / "maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
        names.update(parts[5] for line in lines if len(parts := line.split(maxsplit=5)) == 6)
    if process != "self":
        with suppress(OSError):
            for entry in (folder / "fd").iterdir():
                names.update(_read_only(folder, entry))
    return {Path(name) for name in names if name.startswith("/") and not _is_system(name) and is_user_file(name)}


def _read_only(folder: Path, entry: Path) -> list[str]:
    try:
        flags = (folder / "fdinfo" / entry.name).read_text(encoding="ascii").split("flags:")[1].split()[0]
        return [] if int(flags, 8) & _ACCESS else [str(entry.readlink())]
    except (OSError, IndexError, ValueError):  # closed meanwhile
        return []


def _is_system(name: str) -> bool:
    # Caches, such as those of graphics drivers, are rewritten at any time.
    cached = "/.cache/" in name or "/__pycache__/" in name
    return cached or name.startswith(tuple(f"{folder}{end}/" for folder in _SYSTEM for end in ("", "64")))


def compute_hashes(files: Iterable[Path]) -> dict[str, str]:
    """Return the hash of the contents of every file by its path; files that are gone are omitted."""
    return {str(file): text for file in sorted(files) if (text := _compute_hash(str(file)))}


def have_changed(hashes: Mapping[str, str]) -> bool:
    """Return whether the contents of any file differ from its hash."""
    return any(_compute_hash(name) != text for name, text in hashes.items())


def _compute_hash(name: str) -> str:
    try:
        state = os.stat(name)
        return _hash_of_state(name, state.st_mtime_ns, state.st_size, state.st_ino)
    except OSError:
        return ""


@lru_cache(maxsize=4096)
def _hash_of_state(name: str, *state: int) -> str:
    with open(name, "rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()[:16]

"""What is kept between runs: compiled code and finished textures; where, how much, and whether it can be written."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from scenetruth.cli.doctor.finding import Finding

__all__ = ["look_at_caches"]

_PACKAGE = Path(__file__).resolve().parents[2]


def look_at_caches() -> list[Finding]:
    """Return how the cache of compiled code and that of textures are."""
    return [_compiled(), _textures()]


def _compiled() -> Finding:
    """Look where numba keeps code, which it does beside the modules if it can."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    beside = os.access(_PACKAGE, os.W_OK)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    place = Path(given) if given else _PACKAGE if beside else Path(base) / "numba"
    tag = f".py{sys.version_info.major}{sys.version_info.minor}"
    indices = [file for file in _files(place, "*.nbi") if tag in file.name]
    current = [file for file in indices if not _is_older(file)]
    size = sum(_size(file) for file in _files(place, "*.nbc"))
    where = "beside the package, in __pycache__" if place == _PACKAGE else str(place)
    told = f"{where}: {len(current)} kernels, {size / 1e6:.0f} MB"
    if not _can_be_written(place):
        return Finding(
            "caches", "compiled code", "broken", f"{told}; cannot be written", "set NUMBA_CACHE_DIR elsewhere"
        )
    if not current:
        return Finding("caches", "compiled code", "missing", told, "scenetruth warm-up, a minute or two once")
    return Finding("caches", "compiled code", "ok", told)


def _is_older(index: Path) -> bool:
    """Whether code was compiled from a module, if that lies beside it, that has changed since."""
    source = index.parents[1] / f"{index.name.partition('.')[0]}.py"
    try:
        return source.stat().st_mtime > index.stat().st_mtime
    except OSError:
        return False


def _textures() -> Finding:
    from scenetruth.cache import cache_folder

    folder = cache_folder()
    if folder is None:
        return Finding("caches", "textures", "ok", "off, or there is no home folder: each run makes its own")
    entries = list(_files(folder, "*.entry"))
    told = f"{folder}: {len(entries)} entries, {sum(map(_size, entries)) / 1e6:.0f} MB"
    if _can_be_written(folder):
        return Finding("caches", "textures", "ok", told)
    remedy = "set SCENETRUTH_CACHE to a folder that can be written, or to off"
    return Finding("caches", "textures", "broken", f"{told}; cannot be written", remedy)


def _files(folder: Path, pattern: str) -> Iterable[Path]:
    return folder.rglob(pattern) if folder.is_dir() else ()


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _can_be_written(folder: Path) -> bool:
    """Whether files can be put into a folder, or it can be made."""
    near = next((place for place in (folder, *folder.absolute().parents) if os.path.exists(place)), folder)
    try:
        # What the rights say is not all: some file systems take no files from anybody.
        with tempfile.TemporaryFile(dir=near):
            return True
    except OSError:
        return False

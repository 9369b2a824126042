"""Cache of arrays on disk, shared by runs."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["cache_folder", "entry_key", "has_entry", "load_or_compute", "read_entry", "source_hash", "write_entry"]

_FOLDER, _SIZE = "SCENETRUTH_CACHE", "SCENETRUTH_CACHE_MB"
_OFF = ("off", "0", "no", "false")
_MAX_MB = 1000.0
_MAGIC = b"scenetruth cache 1\n"
_DIGEST = hashlib.sha256().digest_size
_ALIGNMENT = 64
_SUFFIX, _PARTIAL = ".entry", ".aside"
# Age at which temporary files of killed writers are removed.
_ABANDONED_S = 3600.0
_MOST_VERIFIED = 4096  # files whose checksum is remembered

Arrays = dict[str, NDArray[Any]]


def cache_folder() -> Path | None:
    """Return the cache directory; None if caching is disabled.

    The environment variable ``SCENETRUTH_CACHE`` sets it (``off`` disables caching); the default is ``scenetruth`` in
    ``XDG_CACHE_HOME``, or in ``~/.cache``.
    """
    given = os.environ.get(_FOLDER, "").strip()
    if given:
        return None if given.lower() in _OFF else Path(given).expanduser().absolute()
    shared = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG standard requires that relative paths are ignored. Without a home directory, ~ is not expanded.
    base = shared if os.path.isabs(shared) else os.path.expanduser("~/.cache")
    return Path(base) / "scenetruth" if os.path.isabs(base) else None


def entry_key(what: str, *parts: Any) -> str:
    """Return the key of an entry: a hash of everything that determines its contents.

    Every key includes the versions of NumPy and SciPy and the processor, which affect rounding.
    """
    plain = json.dumps([what, _machine(), *parts], sort_keys=True, default=_plain)
    return f"{what}-{hashlib.sha256(plain.encode()).hexdigest()[:40]}"


def _plain(value: Any) -> Any:
    """Convert a value that JSON does not support."""
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.tolist()]
    if isinstance(value, np.generic):
        return value.item()
    message = f"a key cannot contain {type(value).__name__}"
    raise TypeError(message)


@cache
def _machine() -> list[Any]:
    """Return the properties that affect rounding: versions of numerical packages, and the processor."""
    import importlib.metadata

    core = getattr(getattr(np, "_core", None), "_multiarray_umath", None)
    features: Mapping[str, bool] = getattr(core, "__cpu_features__", {})
    versions = [importlib.metadata.version(name) for name in ("numpy", "scipy", "numba", "llvmlite")]
    names = sorted(name for name, there in features.items() if there)
    return [platform.machine(), platform.python_version(), *versions, *names]


@cache
def source_hash(*folders: Path) -> str:
    """Return a hash of all Python files of directories, so that changed code has another key."""
    found = hashlib.sha256()
    for folder in folders:
        for file in sorted(folder.rglob("*.py")):
            found.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return found.hexdigest()


def load_or_compute(key: str, make: Callable[[], Arrays]) -> Arrays:
    """Return arrays from the cache, or compute and cache them."""
    found = read_entry(key)
    if found is None:
        found = make()
        write_entry(key, found)
    return found


def read_entry(key: str) -> Arrays | None:
    """Return the arrays of an entry."""
    folder = cache_folder()
    if folder is None:
        return None
    path = folder / f"{key}{_SUFFIX}"
    try:
        with path.open("rb") as file:
            number = file.fileno()
            raw = np.empty(os.fstat(number).st_size, dtype=np.uint8)
            if file.readinto(raw.data) != len(raw):
                return None
            # Files are replaced, not changed. Scenes that are built again read those that were verified before.
            found = _unpacked(raw, verified=_verified.get(path) == _identity(number))
            if found is not None:
                with contextlib.suppress(OSError):
                    # For removal of the least recently used entries.
                    os.utime(number if os.utime in os.supports_fd else path)
                if len(_verified) >= _MOST_VERIFIED:
                    _verified.clear()
                _verified[path] = _identity(number)
    except OSError:
        return None
    if found is None:
        with contextlib.suppress(OSError):
            path.unlink()
    return found


_verified: dict[Path, tuple[int, ...]] = {}


def _identity(number: int) -> tuple[int, ...]:
    """Return what changes with every change of an open file."""
    state = os.fstat(number)
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


def has_entry(key: str) -> bool:
    """Return whether an entry exists; it may be damaged."""
    folder = cache_folder()
    return folder is not None and (folder / f"{key}{_SUFFIX}").is_file()


def write_entry(key: str, arrays: Arrays) -> None:
    """Cache arrays, and remove the least recently used entries beyond the size limit.

    The environment variable ``SCENETRUTH_CACHE_MB`` sets the limit in megabytes; default: 1000.
    """
    folder = cache_folder()
    most = _max_bytes()
    if folder is None or sum(values.nbytes for values in arrays.values()) > most:
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        number, partial = tempfile.mkstemp(suffix=_PARTIAL, dir=folder)
        try:
            with os.fdopen(number, "wb") as file:
                for piece in _packed(arrays):
                    file.write(piece)
            os.replace(partial, folder / f"{key}{_SUFFIX}")
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(partial)
            raise
        _prune(folder, most)


def _max_bytes() -> float:
    try:
        return float(os.environ.get(_SIZE, _MAX_MB)) * 1e6
    except ValueError:
        return _MAX_MB * 1e6


def _packed(arrays: Arrays) -> list[bytes | memoryview]:
    """Return the parts of an entry: magic bytes, checksum of the rest, description, arrays."""
    whole = {name: np.asarray(values, order="C") for name, values in arrays.items()}
    head = json.dumps([[name, values.dtype.str, values.shape] for name, values in whole.items()]).encode()
    before = len(_MAGIC) + _DIGEST + 8
    head += b" " * (-(before + len(head)) % _ALIGNMENT)
    pieces: list[bytes | memoryview] = [len(head).to_bytes(8, "little") + head]
    for values in whole.values():
        pieces += [values.reshape(-1).view(np.uint8).data, bytes(-values.nbytes % _ALIGNMENT)]
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return [_MAGIC, digest.digest(), *pieces]


def _unpacked(raw: NDArray[np.uint8], *, verified: bool = False) -> Arrays | None:
    """Return the arrays of an entry; None if its checksum does not match, which is tested unless it is verified."""
    first = len(_MAGIC) + _DIGEST
    start = raw[:first].tobytes()
    if len(raw) < first + 8 or not start.startswith(_MAGIC):
        return None
    if not verified and start != _MAGIC + hashlib.sha256(raw[first:].data).digest():
        return None
    behind = first + 8 + int.from_bytes(raw[first : first + 8].tobytes(), "little")
    found: Arrays = {}
    for name, form, shape in json.loads(raw[first + 8 : behind].tobytes()):
        kind = np.dtype(form)
        size = kind.itemsize * int(np.prod(shape, dtype=np.int64))
        found[name] = raw[behind : behind + size].view(kind).reshape(shape)
        behind += size + -size % _ALIGNMENT
    return found


def _prune(folder: Path, most: float) -> None:
    entries = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process may remove entries simultaneously
            state = path.stat()
            if path.suffix == _SUFFIX:
                entries.append((state.st_mtime, state.st_size, path))
            elif path.suffix == _PARTIAL and state.st_mtime < time.time() - _ABANDONED_S:
                path.unlink()
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries, key=lambda entry: entry[0]):
        if total <= most:
            break
        with contextlib.suppress(OSError):
            path.unlink()
        total -= size

"""Results of tasks: errors returned as values, files named by content, and an append-only log."""

from __future__ import annotations

import json
import math
import os
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from scenetruth.errors import StoreError
from scenetruth.jobs.worker_setup import refuse_other_versions
from scenetruth.output import is_full_disk, write_atomically
from scenetruth.plain_data import parse_json
from scenetruth.schema import digest

__all__ = [
    "ResultLog",
    "ResultStore",
    "TaskResult",
    "compute_key",
    "describe_error",
    "perform_task",
    "refuse_damaged",
    "write_arrays",
]


@dataclass(frozen=True)
class TaskResult:
    """The result of a task, or its error.

    ``number``: Number of the task. ``values``: The values that the task returned; empty if it failed. ``failure``: The
    error as plain values, with a ``message``; empty if there was none. ``seconds``: Duration of the task.
    ``disk_full``: Whether the task failed because the disk was full. Such a task is repeated without limit.
    """

    number: int
    values: dict[str, Any] = field(default_factory=dict)
    failure: dict[str, Any] = field(default_factory=dict)
    seconds: float = math.nan
    disk_full: bool = False


def describe_error(error: Exception) -> dict[str, Any]:
    """Return the type and the message of an error as plain values."""
    return {"error": type(error).__name__, "message": str(error)}


def perform_task(
    number: int,
    work: Callable[[], Mapping[str, Any]],
    *,
    label: str = "",
    describe: Callable[[Exception], dict[str, Any]] = describe_error,
    versions: Iterable[tuple[str, str]] = (),
    raised: tuple[type[Exception], ...] = (),
) -> TaskResult:
    """Perform a task and return its error instead of raising it, so that the other tasks are not affected."""
    start = time.perf_counter()
    refuse_other_versions(dict(versions))
    try:
        values = dict(work())
    except raised:
        raise
    except Exception as error:  # of any type: the job continues and reports it
        failure = describe(error)
        if label:
            failure["message"] = f"{label}: {type(error).__name__}: {error}"
        seconds = time.perf_counter() - start
        return TaskResult(number, failure=failure, seconds=seconds, disk_full=is_full_disk(error))
    return TaskResult(number, values, seconds=time.perf_counter() - start)


def compute_key(depends: Any, default: Callable[[Any], Any] = list) -> str:
    """Return the digest of all values on which a result depends.

    >>> compute_key({"scene": "cube", "seeds": (1, 2)}) == compute_key({"seeds": [1, 2], "scene": "cube"})
    True
    """
    return digest(json.loads(json.dumps(depends, default=default)))


def has_retryable_failures(values: Mapping[str, Any]) -> bool:
    """Return whether a result has failures that may not occur again: ``failures`` that are not ``settled``."""
    failures, settled = values.get("failures"), values.get("settled")
    return bool(set(failures if isinstance(failures, dict) else ()).difference(settled or ()))


@contextmanager
def refuse_damaged(path: Path, remedy: str) -> Iterator[None]:
    """Raise `StoreError` if the file that the block reads is missing or damaged."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and {remedy}") from error


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays to a compressed npz file, atomically, and create its directory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(path, overwrite=True) as scratch, scratch.open("wb") as stream:
        np.savez_compressed(stream, **dict(arrays))


@dataclass(frozen=True)
class ResultStore:
    """Results of tasks in a directory: one JSON file each, and an npz file with the same name for arrays.

    A file contains the key of its task, the digest of all values on which the result depends, which is usually also its
    name. A file with another key is not the result of the task.

    ``folder``: The directory.
    ``remedy``: Imperative that replaces a damaged file after it was removed, for example "run the sweep again".
    """

    folder: Path
    remedy: str

    def path(self, name: str) -> Path:
        """Return the file of a result."""
        return self.folder / f"{name}.json"

    def arrays_path(self, name: str) -> Path:
        """Return the file of the arrays of a result."""
        return self.folder / f"{name}.npz"

    def find(self, name: str, key: str) -> dict[str, Any] | None:
        """Return a result; None if its file is missing, damaged or of another key."""
        try:
            values = parse_json(self.path(name).read_bytes())
        except (OSError, ValueError):
            return None
        return values if isinstance(values, dict) and values.get("key") == key else None

    def is_done(self, name: str, key: str, *, arrays: bool = False) -> bool:
        """Return whether a result exists without a failure that is to be retried."""
        values = self.find(name, key)
        done = values is not None and not has_retryable_failures(values)
        return done and (not arrays or self.arrays_path(name).exists())

    def write(self, name: str, key: str, values: Mapping[str, Any]) -> None:
        """Write a result atomically; arrays are written before, because this file marks the result as complete."""
        path = self.path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path, overwrite=True) as scratch:
            scratch.write_text(
                json.dumps({"key": key, **values}, ensure_ascii=False, allow_nan=False), encoding="utf-8"
            )

    @contextmanager
    def reading(self, name: str) -> Iterator[dict[str, Any]]:
        """Yield the values of a result to the block that interprets them."""
        path = self.path(name)
        with refuse_damaged(path, self.remedy):
            yield dict(parse_json(path.read_bytes()))


class ResultLog:
    """Results appended to a file, one JSON object with a ``key`` per line.

    An incomplete last line of a killed process is ignored.

    ``file``: The file; None to write none.
    """

    def __init__(self, file: Path | None) -> None:
        self.lines: list[dict[str, Any]] = [] if file is None else _read_lines(file)
        self._stream: TextIO | None = None
        if file is not None:
            _complete_last_line(file)
            self._stream = file.open("a", encoding="utf-8")

    def append(self, key: str, values: Mapping[str, Any]) -> None:
        """Append a result, and flush the file."""
        if self._stream is not None:
            self._stream.write(json.dumps({"key": key, **values}, ensure_ascii=False) + "\n")
            self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        if self._stream is not None:
            self._stream.close()


def _read_lines(file: Path) -> list[dict[str, Any]]:
    try:
        texts = file.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return []
    lines = []
    for text in texts:
        try:
            line = parse_json(text)
        except ValueError:
            continue
        if isinstance(line, dict) and "key" in line:
            lines.append(line)
    return lines


def _complete_last_line(file: Path) -> None:
    if not file.exists() or not file.stat().st_size:
        return
    with file.open("rb+") as stream:
        stream.seek(-1, os.SEEK_END)
        if stream.read(1) != b"\n":
            stream.write(b"\n")

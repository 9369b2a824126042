"""Checksums of what a data set states: records that contain their own, and lists of the SHA-256 of files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from scenetruth.errors import StoreError
from scenetruth.output import write_atomically
from scenetruth.plain_data import parse_json

__all__ = [
    "check_listed",
    "dump_record",
    "file_sha256",
    "has_checksum",
    "list_path",
    "load_record",
    "refuse_unlike_checksum",
    "write_checksums",
    "write_with_checksums",
]


_KEY = "sha256"
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _record_sha256(record: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the values of a record; the layout of its text does not matter."""
    plain = {name: value for name, value in record.items() if name != _KEY}
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def dump_record(record: Mapping[str, Any], indent: int | None = 1) -> str:
    """Return a record as JSON, with its checksum.

    >>> load_record(dump_record({"sample": 4}).encode())
    {'sample': 4}
    """
    signed = {**record, _KEY: _record_sha256(record)}
    return json.dumps(signed, indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def load_record(text: bytes, *, required: bool = False) -> dict[str, Any]:
    """Return a record without its checksum; raise `ValueError` if it differs, or is missing though ``required``.

    >>> load_record(dump_record({"sample": 4}).encode().replace(b"4,", b"5,"))
    Traceback (most recent call last):
    ValueError: its values do not match their checksum
    """
    found = parse_json(text)
    if not isinstance(found, dict):
        msg = "is not a record"
        raise ValueError(msg)
    given = found.pop(_KEY, None)
    if given is None and required:
        msg = "it has no checksum"
        raise ValueError(msg)
    if given is not None and given != _record_sha256(found):
        msg = "its values do not match their checksum"
        raise ValueError(msg)
    return found


def has_checksum(text: bytes) -> bool:
    """Return whether a record carries a checksum."""
    return _KEY in parse_json(text)


def list_path(path: Path) -> Path:
    """Return the list of checksums of a single file: ``catalogue.sha256`` for ``catalogue.parquet``."""
    return path.with_suffix(".sha256")


def write_with_checksums(files: Mapping[Path, Callable[[Path], object]], *, also: Iterable[Path] = ()) -> None:
    """Write files of one directory in order, and the list of their checksums and of other files there.

    While files are replaced the list holds the checksums of both states, so that a killed run leaves no mismatch.
    """
    targets = list(files)
    listed = list_path(targets[-1])
    with ExitStack() as stack:
        # Files are moved into place in reverse order of this loop.
        partials = {one: stack.enter_context(write_atomically(one, overwrite=True)) for one in reversed(targets)}
        for target, write in files.items():
            write(partials[target])
        new = [(file_sha256(partials[target]), target.name) for target in targets]
        new += [(file_sha256(file), file.name) for file in also]
        _write_lines(listed, [*new, *_read_lines(listed)])
    _write_lines(listed, new)


def write_checksums(listed: Path, files: list[Path]) -> None:
    """Write the list of the checksums of existing files in or below the directory of the list."""
    _write_lines(listed, [(file_sha256(file), file.relative_to(listed.parent).as_posix()) for file in files])


def refuse_unlike_checksum(file: Path, remedy: str) -> None:
    """Raise if a file does not match its checksum; a file without one is accepted."""
    for _ in range(_TRIES):
        # Another process may replace both between two readings.
        problems = check_listed(list_path(file), [file], remedy) if list_path(file).exists() else []
        problems = [one for one in problems if one[0] in (file.name, list_path(file).name)]
        if not problems:
            return
    raise StoreError(file.with_name(problems[0][0]), problems[0][1])


_TRIES = 3


def check_listed(listed: Path, files: list[Path], remedy: str) -> list[tuple[str, str]]:
    """Return the names and problems of files whose content, or checksum, is missing or has changed."""
    try:
        lines = _read_lines(listed, strict=True)
    except ValueError as error:
        return [(listed.name, f"{error}; {remedy}")]
    names = [file.relative_to(listed.parent).as_posix() for file in files if file.exists()]
    if not lines:
        return [(name, f"has no checksum: {listed.name} is missing; {remedy}") for name in names]
    problems = []
    for name in dict.fromkeys([*names, *(name for _, name in lines)]):
        known = [digest for digest, one in lines if one == name]
        try:
            found = file_sha256(listed.parent / name)
        except OSError as error:
            problems.append((name, f"cannot be read: {error.strerror}; {remedy}"))
            continue
        if not known:
            problems.append((name, f"has no checksum in {listed.name}; {remedy}"))
        elif found not in known:
            problems.append((name, f"has changed: it does not match its checksum in {listed.name}; {remedy}"))
    return problems


def _read_lines(listed: Path, *, strict: bool = False) -> list[tuple[str, str]]:
    """Return the checksums and names of a list; a damaged list is empty, unless ``strict``."""
    try:
        text = listed.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        if strict:
            msg = f"cannot be read: {error}"
            raise ValueError(msg) from error
        return []
    matches = [_LINE.fullmatch(line) for line in text.splitlines()]
    if strict and not all(matches):
        msg = "is damaged: its lines are not a SHA-256 and a name"
        raise ValueError(msg)
    return [(match[1], match[2]) for match in matches if match]


def _write_lines(listed: Path, lines: list[tuple[str, str]]) -> None:
    with write_atomically(listed, overwrite=True) as partial:
        partial.write_text("".join(f"{digest}  {name}\n" for digest, name in dict.fromkeys(lines)), encoding="utf-8")

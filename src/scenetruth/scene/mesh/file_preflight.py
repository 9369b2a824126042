"""Checks of a mesh file before parsing: size, format, and counts in the header."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import describe_missing, regular_file_size

__all__ = [
    "MAX_ELEMENTS",
    "MAX_FILE_BYTES",
    "MAX_TEXELS",
    "check_file_size",
    "count_elements",
    "read_checked_bytes",
    "read_unchanged",
    "refuse_mesh_file",
]

FORMATS = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
"""Suffixes of supported formats; other formats, including archives, are rejected."""
MAX_FILE_BYTES = 500_000_000
"""Maximum size of a mesh, image or array file."""
MAX_ELEMENTS = 20_000_000
"""Maximum number of vertices or faces of a file, as for generated meshes."""
MAX_TEXELS = 64_000_000
"""Maximum number of texels of an image (8000 x 8000), some hundred megabytes after decoding."""

_HEADER = 65_536
_ATTEMPTS = 3  # largest number of times that a file is read that other programs change

_T = TypeVar("_T")


def refuse_mesh_file(file: Path) -> None:
    """Raise a SceneError for files of other formats, too large files, or implausible element counts."""
    size = check_file_size(file, MAX_FILE_BYTES, "no such mesh file")
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        message = f"unsupported format: use one of {', '.join(FORMATS)}"
        raise SceneError([Problem("file", message, str(file))])
    if size == 0:
        raise SceneError([Problem("file", "is empty", str(file))])
    if suffix == ".ply":
        with file.open("rb") as stream:
            head = stream.read(_HEADER).partition(b"end_header")[0]
        counts = [int(number) for number in re.findall(rb"element\s+\w+\s+(\d{1,18})", head)]
    elif suffix in (".glb", ".gltf"):
        counts = _counts_of_gltf(file)
    else:
        return
    # Every element takes at least one byte, except in glTF, where it may be implicitly zero.
    most = MAX_ELEMENTS if suffix in (".glb", ".gltf") else min(MAX_ELEMENTS, size)
    if any(count > most for count in counts):
        message = f"declares {max(counts):,} elements; the maximum is {most:,}"
        raise SceneError([Problem("file", message, str(file))])


def count_elements(file: Path, piece_bytes: int = 1 << 22) -> tuple[int, int]:
    """Return the approximate numbers of vertices and triangles of a mesh file; text files are counted by lines."""
    suffix = file.suffix.lower()
    if suffix == ".ply":
        with file.open("rb") as stream:
            head = stream.read(_HEADER).partition(b"end_header")[0]
        counts = {name: int(count) for name, count in re.findall(rb"element\s+(\w+)\s+(\d{1,18})", head)}
        return counts.get(b"vertex", 0), counts.get(b"face", 0)
    if suffix in (".glb", ".gltf"):
        largest = max(_counts_of_gltf(file), default=0)
        # Three indices of an accessor form a triangle.
        return largest // 3 + 2, largest // 3
    if suffix == ".off":
        with file.open("rb") as stream:
            numbers = re.findall(rb"\d{1,18}", stream.read(_HEADER))[:2]
        return (int(numbers[0]), int(numbers[1])) if len(numbers) == 2 else (0, 0)
    if suffix == ".stl":
        size = file.stat().st_size
        with file.open("rb") as stream:
            head = stream.read(84)
        count = int.from_bytes(head[80:84], "little")
        if size == 84 + 50 * count:
            return 3 * count, count
        corners = _lines_with(file, (b"vertex ",), piece_bytes)[0]
        return corners, corners // 3
    vertices, faces = _lines_with(file, (b"\nv ", b"\nf "), piece_bytes)
    return vertices, faces


def _lines_with(file: Path, words: tuple[bytes, ...], piece_bytes: int) -> list[int]:
    """Return the number of occurrences of words in a file, read in blocks."""
    found, last = [0] * len(words), b"\n"
    longest = max(map(len, words))
    with file.open("rb") as stream:
        while piece := stream.read(piece_bytes):
            text = last + piece
            # Matches that end in the overlap have already been counted.
            old = [last.count(word) for word in words]
            found = [count + text.count(word) - before for count, word, before in zip(found, words, old, strict=True)]
            last = text[1 - longest :]
    return found


def check_file_size(file: Path, most: int, missing: str) -> int:
    """Return the size of a file in bytes, or raise a SceneError above the maximum."""
    try:
        size = regular_file_size(file)
    except ValueError as error:
        raise SceneError([Problem("file", str(error), str(file))]) from error
    except OSError as error:
        missing = describe_missing(file, missing)
        values = (
            missing if isinstance(error, FileNotFoundError | NotADirectoryError) else f"{missing}: {error.strerror}"
        )
        raise SceneError([Problem("file", values, str(file))]) from error
    if size > most:
        raise SceneError([Problem("file", f"has {size:,} bytes; the maximum is {most:,}", str(file))])
    return size


def read_unchanged(file: Path, read: Callable[[Path], _T]) -> _T:
    """Return the result of a function that reads a file, repeatedly if another program changes the file meanwhile."""
    for _ in range(_ATTEMPTS):
        before = _state(file)
        failure: SceneError | None = None
        try:
            found = read(file)
        except SceneError as error:
            failure = error
        except OSError as error:
            failure = SceneError([Problem("file", f"cannot be read: {error.strerror}", str(file))])
        if _state(file) == before:
            if failure is not None:
                raise failure
            return found
    message = f"{file.name} changes while it is read: wait until the program that writes it has finished"
    raise SceneError([Problem("file", message, str(file))]) from failure


def _state(file: Path) -> tuple[int, ...] | None:
    """Return what changes with the content of a file; None for a missing file."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def read_checked_bytes(file: Path) -> bytes:
    """Return the content of a referenced file after a size check."""
    if regular_file_size(file) > MAX_FILE_BYTES:
        msg = f"{file.name} has more than {MAX_FILE_BYTES:,} bytes"
        raise ValueError(msg)
    return file.read_bytes()


def _counts_of_gltf(file: Path) -> list[int]:
    """Return the counts of all accessors of a glTF file; empty for unreadable files, which the parser reports."""
    with file.open("rb") as stream:
        head = stream.read(20)
        if head[:4] == b"glTF":
            text = stream.read(min(int.from_bytes(head[12:16], "little"), MAX_FILE_BYTES))
        else:
            text = head + stream.read()
    try:
        entries = json.loads(text)["accessors"]
        return [entry["count"] for entry in entries if isinstance(entry.get("count"), int)]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return []

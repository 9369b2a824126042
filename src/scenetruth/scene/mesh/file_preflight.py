"""Checks of a mesh file before a library reads it: size, format, and the counts in its header."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import regular_file_size

__all__ = [
    "MAX_ELEMENTS",
    "MAX_FILE_BYTES",
    "MAX_TEXELS",
    "check_file_size",
    "count_elements",
    "make_checked_resolver",
    "read_checked_bytes",
    "refuse_mesh_file",
]

FORMATS = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
"""Suffixes of the formats that are read; others, archives among them, are not tried."""
MAX_FILE_BYTES = 500_000_000
"""Largest file of a mesh, a picture or an array."""
MAX_ELEMENTS = 20_000_000
"""Vertices or faces of a file, as of the meshes that are made here."""
MAX_TEXELS = 64_000_000
"""Texels of an image: 8000 x 8000. Decoded, with the radiances that are made of it, it takes some hundred megabytes."""

_HEADER = 65_536
_PIECE = 1 << 22


def refuse_mesh_file(file: Path) -> None:
    """Refuse what is no mesh file, is too large, or claims more vertices and faces than it can hold."""
    size = check_file_size(file, MAX_FILE_BYTES, "no such mesh file")
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        message = f"is no format that is read: give a file that ends in {', '.join(FORMATS)}"
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
    # Every element takes a byte at least, but for glTF's, which may stand for zeros.
    most = MAX_ELEMENTS if suffix in (".glb", ".gltf") else min(MAX_ELEMENTS, size)
    if any(count > most for count in counts):
        message = f"claims {max(counts):,} elements; it can have at most {most:,}"
        raise SceneError([Problem("file", message, str(file))])


def count_elements(file: Path) -> tuple[int, int]:
    """Return about how many vertices and triangles a mesh file holds; of a text its lines are counted."""
    suffix = file.suffix.lower()
    if suffix == ".ply":
        with file.open("rb") as stream:
            head = stream.read(_HEADER).partition(b"end_header")[0]
        counts = {name: int(count) for name, count in re.findall(rb"element\s+(\w+)\s+(\d{1,18})", head)}
        return counts.get(b"vertex", 0), counts.get(b"face", 0)
    if suffix in (".glb", ".gltf"):
        largest = max(_counts_of_gltf(file), default=0)
        # Three indices of one accessor make a triangle.
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
        corners = _lines_with(file, (b"vertex ",))[0]
        return corners, corners // 3
    vertices, faces = _lines_with(file, (b"\nv ", b"\nf "))
    return vertices, faces


def _lines_with(file: Path, words: tuple[bytes, ...]) -> list[int]:
    """Return how often words stand in a file, which is read in pieces."""
    found, last = [0] * len(words), b"\n"
    longest = max(map(len, words))
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE):
            text = last + piece
            # What ends in the overlap was counted before.
            old = [last.count(word) for word in words]
            found = [count + text.count(word) - before for count, word, before in zip(found, words, old, strict=True)]
            last = text[1 - longest :]
    return found


def check_file_size(file: Path, most: int, missing: str) -> int:
    """Return the size of a file in bytes."""
    try:
        size = regular_file_size(file)
    except ValueError as error:
        raise SceneError([Problem("file", str(error), str(file))]) from error
    except OSError as error:
        told = missing if isinstance(error, FileNotFoundError | NotADirectoryError) else f"{missing}: {error.strerror}"
        raise SceneError([Problem("file", told, str(file))]) from error
    if size > most:
        raise SceneError([Problem("file", f"has {size:,} bytes; at most {most:,} are read", str(file))])
    return size


def read_checked_bytes(file: Path) -> bytes:
    """Return the content of a file that another file refers to."""
    if regular_file_size(file) > MAX_FILE_BYTES:
        msg = f"{file.name} has more than {MAX_FILE_BYTES:,} bytes"
        raise ValueError(msg)
    return file.read_bytes()


def make_checked_resolver(file: Path) -> Any:
    """Return what gives trimesh the files that a mesh file refers to: regular ones of reasonable size only."""
    import trimesh.resolvers

    class Resolver(trimesh.resolvers.FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            return read_checked_bytes(Path(self.parent) / name.strip())

    return Resolver(str(file))


def _counts_of_gltf(file: Path) -> list[int]:
    """Return the counts of all accessors of a glTF file; nothing of one that cannot be read, which its reader tells."""
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

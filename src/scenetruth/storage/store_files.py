"""Files of a store, in a directory or a zip file: names, checksums and ownership."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Mapping
from functools import cached_property
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol, cast

from scenetruth.errors import StoreError
from scenetruth.output import OwnershipResult, describe_foreign_files

__all__ = [
    "CHECKSUM_ATTRIBUTE",
    "RECORDING",
    "ROOT",
    "SCENE",
    "TRUTH",
    "StagedFiles",
    "StoreFiles",
    "StoredFiles",
    "add_checksums",
    "check_checksums",
    "claim_store",
    "differs_from_packed",
    "is_store",
    "is_zip_name",
    "open_store_files",
    "pack",
    "store_name",
]


SCENE = "scene.yaml"
"""Scene file with all defaults and overrides."""

RECORDING = "recording"
"""Stem of the store that holds the images."""

TRUTH = "truth"
"""Stem of the store that holds the ground truth."""


def store_name(stem: str, *, zipped: bool) -> str:
    """Return the file name of a store: a directory, or a zip file.

    >>> store_name(TRUTH, zipped=False), store_name("estimate", zipped=True)
    ('truth.zarr', 'estimate.zarr.zip')
    """
    return f"{stem}.zarr" + (".zip" if zipped else "")


ROOT = "zarr.json"
"""Metadata file of a store."""

_ZIP = ".zip"
# Exceptions that zipfile raises for a damaged file, in addition to OSError.
_DAMAGED = (
    zipfile.BadZipFile,
    KeyError,
    ValueError,
    NotImplementedError,
    EOFError,
    RuntimeError,
    zlib.error,
    struct.error,
)
_BLOCK = 1 << 20


def is_zip_name(path: Path) -> bool:
    """Return whether the name of a store is that of a zip file (``recording.zarr.zip``)."""
    return path.suffix == _ZIP


def is_part(name: str) -> bool:
    """Return whether a path inside a store is a metadata or chunk file."""
    parts = PurePosixPath(name).parts
    return parts[-1] == ROOT or (len(parts) > 2 and parts[1] == "c")


class StoreFiles(Protocol):
    """Read access to the files of a store by relative path."""

    def sizes(self) -> Mapping[str, int]:
        """Return the size in bytes of every file of the store, sorted by path."""
        ...

    def foreign(self) -> list[str]:
        """Return the paths of files that do not belong to the store."""
        ...

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        ...

    def open(self, name: str) -> IO[bytes]:
        """Open a file for reading."""
        ...


class StoredFiles(StoreFiles, Protocol):
    """Files of a finished store."""

    def holds(self, name: str) -> bool:
        """Return whether the store has a file."""
        ...

    def locate(self, name: str) -> tuple[Path, int, int]:
        """Return the path on disk that contains a file of the store, the position of its first byte, and its size."""
        ...


def open_store_files(path: Path) -> StoredFiles:
    """Return the files of the store at a path."""
    return _Zip(path) if is_zip_name(path) else _Folder(path)


class _Folder:
    def __init__(self, path: Path) -> None:
        self._path = path

    def _all(self) -> dict[str, Path]:
        found = {}
        for folder, folders, files in os.walk(self._path):
            for name in files + [name for name in folders if os.path.islink(os.path.join(folder, name))]:
                file = Path(folder, name)
                found[file.relative_to(self._path).as_posix()] = file
        return found

    def sizes(self) -> dict[str, int]:
        return {name: file.stat().st_size for name, file in sorted(self._all().items()) if is_part(name)}

    def foreign(self) -> list[str]:
        return sorted(name for name in self._all() if not is_part(name))

    def read(self, name: str) -> bytes:
        return (self._path / name).read_bytes()

    def open(self, name: str) -> IO[bytes]:
        return (self._path / name).open("rb")

    def holds(self, name: str) -> bool:
        return (self._path / name).exists()

    def locate(self, name: str) -> tuple[Path, int, int]:
        file = self._path / name
        return file, 0, file.stat().st_size


class StagedFiles:
    """Files of a store that is being written: content in memory, or the path of a finished file."""

    def __init__(self, parts: Mapping[str, bytes | Path]) -> None:
        self._parts = dict(sorted(parts.items()))

    def sizes(self) -> dict[str, int]:
        """Return the size in bytes of every file of the store, sorted by path."""
        return {name: len(it) if isinstance(it, bytes) else it.stat().st_size for name, it in self._parts.items()}

    def foreign(self) -> list[str]:
        """Return the paths of files that do not belong to the store."""
        return [name for name in self._parts if not is_part(name)]

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        with self.open(name) as stream:
            return stream.read()

    def open(self, name: str) -> IO[bytes]:
        """Open a file for reading."""
        part = self._parts[name]
        return BytesIO(part) if isinstance(part, bytes) else part.open("rb")

    def save(self, folder: Path) -> None:
        """Write the content in memory to the directory of the store, where the finished files are."""
        for name, part in self._parts.items():
            if isinstance(part, bytes):
                file = folder / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(part)


class _Zip:
    def __init__(self, path: Path) -> None:
        self._path = path

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self._path)
        except _DAMAGED as error:
            raise OSError(f"is not a zip file or is damaged: {error}") from error

    def sizes(self) -> dict[str, int]:
        items = sorted(self._archive.infolist(), key=lambda one: one.filename)
        return {item.filename: item.file_size for item in items}

    def foreign(self) -> list[str]:
        return [name for name in self.sizes() if not is_part(name)]

    def read(self, name: str) -> bytes:
        archive = self._archive
        try:
            return archive.read(name)
        except _DAMAGED as error:
            raise OSError(f"holds no intact {name}: {error}") from error

    def open(self, name: str) -> IO[bytes]:
        return self._archive.open(name)

    def holds(self, name: str) -> bool:
        return name in self._archive.NameToInfo

    def locate(self, name: str) -> tuple[Path, int, int]:
        item = self._archive.getinfo(name)
        if item.compress_type != zipfile.ZIP_STORED:
            msg = f"{name} is compressed"
            raise OSError(msg)
        with self._path.open("rb") as file:
            file.seek(item.header_offset)
            header = file.read(_ZIP_HEADER.size)
        return self._path, item.header_offset + _ZIP_HEADER.size + sum(_ZIP_HEADER.unpack(header)), item.file_size


_ZIP_HEADER = struct.Struct("<26xHH")
"""Header before each file of a zip file, which ends with the lengths of the name and of the extra field after it."""


def pack(files: StoreFiles, target: Path) -> None:
    """Write the files of a store to one uncompressed zip file, byte for byte reproducible."""
    with target.open("wb") as stream:
        _pack(files, stream)


def _pack(files: StoreFiles, stream: IO[bytes]) -> None:
    # A non-seekable stream makes the bytes independent of the target.
    with zipfile.ZipFile(cast(Any, _Forwards(stream)), "w", zipfile.ZIP_STORED) as archive:
        for name in files.sizes():
            info = zipfile.ZipInfo(name)
            info.external_attr = 0o644 << 16
            with files.open(name) as source, archive.open(info, "w", force_zip64=True) as part:
                shutil.copyfileobj(source, part, _BLOCK)


def differs_from_packed(path: Path) -> bool:
    """Return whether a zip file differs from the output of `pack` for the same content."""
    try:
        with path.open("rb") as stream:
            comparison = _Comparison(stream)
            _pack(_Zip(path), cast(Any, comparison))
            return comparison.differs or bool(stream.read(1))
    except (OSError, *_DAMAGED):
        return True


class _Forwards:
    """A write-only, non-seekable stream."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, data: bytes) -> int:
        self._stream.write(data)
        return len(data)

    def flush(self) -> None:
        pass


class _Comparison:
    """A stream that compares the bytes written to it with an existing file."""

    def __init__(self, there: IO[bytes]) -> None:
        self._there, self.differs = there, False

    def write(self, data: bytes) -> int:
        self.differs |= self._there.read(len(data)) != bytes(data)
        return len(data)


CHECKSUM_ATTRIBUTE = "content"
"""Attribute of a store that holds its checksums."""

_BLANK = "0" * 64


def add_checksums(files: StoreFiles) -> bytes:
    """Return the metadata of a store with checksums: file count, bytes of chunks, SHA-256 of metadata, names, sizes.

    Chunks have their own checksums. The digest field itself counts as zeros.
    """
    sizes = files.sizes()
    metadata = json.loads(files.read(ROOT))
    metadata["attributes"][CHECKSUM_ATTRIBUTE] = {**_count(sizes), "sha256": _BLANK}
    blank = json.dumps(metadata, indent=2, ensure_ascii=True).encode()
    return blank.replace(_BLANK.encode(), _digest(files, sizes, blank).encode(), 1)


def check_checksums(path: Path, files: StoreFiles, attributes: dict[str, Any]) -> None:
    """Raise a StoreError if the metadata, file names or file sizes of a store differ from its checksums."""
    sealed = attributes.get(CHECKSUM_ATTRIBUTE)
    if not isinstance(sealed, dict):
        raise StoreError(path, "has no checksums, so its integrity cannot be verified; create it again")
    counted = {name: sealed.get(name) for name in ("files", "bytes")}
    sizes = files.sizes()
    found = _count(sizes)
    if counted != found:
        held = f"written with {_format_count(counted)}, but it holds {_format_count(found)}"
        message = f"is damaged or truncated: {held}; create it again"
        raise StoreError(path, message)
    root, digest = files.read(ROOT), str(sealed.get("sha256"))
    if digest != _digest(files, sizes, root.replace(digest.encode(), _BLANK.encode(), 1)):
        message = "is damaged: its metadata, or the names or sizes of its files, have changed; create it again"
        raise StoreError(path, message)


def _format_count(count: dict[str, Any]) -> str:
    return f"{count['files']} files and {count['bytes']} bytes of chunks"


def _count(sizes: Mapping[str, int]) -> dict[str, int]:
    return {
        "files": len(sizes) - 1,
        "bytes": sum(size for name, size in sizes.items() if PurePosixPath(name).name != ROOT),
    }


def _digest(files: StoreFiles, sizes: Mapping[str, int], root: bytes) -> str:
    found = hashlib.sha256(root)
    for name, size in sizes.items():
        if name != ROOT:
            found.update(name.encode() + b"\0")
            found.update(files.read(name) if PurePosixPath(name).name == ROOT else str(size).encode())
    return found.hexdigest()


def claim_store(path: Path) -> OwnershipResult:
    """Return whether a directory or zip file is a store written by scenetruth without foreign files."""
    if is_zip_name(path) == path.is_dir() or not is_store(path):
        return OwnershipResult("is not a store that scenetruth wrote")
    foreign = open_store_files(path).foreign()
    return OwnershipResult(describe_foreign_files(foreign)) if foreign else OwnershipResult()


def is_store(path: Path) -> bool:
    """Return whether a directory or zip file has the metadata of a store written by scenetruth, even if damaged."""
    try:
        return b'"scenetruth"' in open_store_files(path).read(ROOT)
    except OSError:
        return False

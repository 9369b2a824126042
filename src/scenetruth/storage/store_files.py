"""The files of a store: in a folder, or in one zip file."""

from __future__ import annotations

import shutil
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol, cast

__all__ = ["ROOT", "StoreFiles", "differs_from_packed", "files_of", "is_part", "is_zip_name", "pack"]

ROOT = "zarr.json"
"""The file with the metadata of a store."""

_ZIP = ".zip"
# What zipfile raises where a file is damaged, besides OSError.
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
    """Tell whether a store of this name is one zip file: ``recording.zarr.zip``."""
    return path.suffix == _ZIP


def is_part(name: str) -> bool:
    """Tell whether a path inside a store is that of a file which stores consist of."""
    parts = PurePosixPath(name).parts
    return parts[-1] == ROOT or (len(parts) > 2 and parts[1] == "c")


class StoreFiles(Protocol):
    """The files of a store, by their paths inside it."""

    def sizes(self) -> Mapping[str, int]:
        """Return the bytes of every file that belongs to the store, sorted by path."""
        ...

    def foreign(self) -> list[str]:
        """Return what is there but does not belong to a store."""
        ...

    def read(self, name: str) -> bytes:
        """Return what a file holds.

        Raises
        ------
        OSError
            If it cannot be read.
        """
        ...


def files_of(path: Path) -> StoreFiles:
    """Return the files of the store at a path."""
    return _Zip(path) if is_zip_name(path) else _Folder(path)


class _Folder:
    def __init__(self, path: Path) -> None:
        self._path = path

    def _all(self) -> dict[str, Path]:
        found = (file for file in self._path.rglob("*") if file.is_symlink() or not file.is_dir())
        return {file.relative_to(self._path).as_posix(): file for file in found}

    def sizes(self) -> dict[str, int]:
        return {name: file.stat().st_size for name, file in sorted(self._all().items()) if is_part(name)}

    def foreign(self) -> list[str]:
        return sorted(name for name in self._all() if not is_part(name))

    def read(self, name: str) -> bytes:
        return (self._path / name).read_bytes()


class _Zip:
    def __init__(self, path: Path) -> None:
        self._path = path

    def _opened(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self._path)
        except _DAMAGED as error:
            raise OSError(f"is no zip file, or damaged: {error}") from error

    def sizes(self) -> dict[str, int]:
        with self._opened() as archive:
            return {item.filename: item.file_size for item in sorted(archive.infolist(), key=lambda one: one.filename)}

    def foreign(self) -> list[str]:
        return [name for name in self.sizes() if not is_part(name)]

    def read(self, name: str) -> bytes:
        with self._opened() as archive:
            try:
                return archive.read(name)
            except _DAMAGED as error:
                raise OSError(f"holds no whole {name}: {error}") from error


def pack(folder: Path, target: Path) -> None:
    """Put the files of a store into one zip file, the same bytes each time; they are packed already."""
    with target.open("wb") as stream:
        _pack(folder, stream)


def _pack(folder: Path, stream: IO[bytes]) -> None:
    # A stream that cannot go back: what is written does not depend on how.
    with zipfile.ZipFile(cast(Any, _Forwards(stream)), "w", zipfile.ZIP_STORED) as archive:
        for name in _Folder(folder).sizes():
            info = zipfile.ZipInfo(name)
            info.external_attr = 0o644 << 16
            with (folder / name).open("rb") as source, archive.open(info, "w", force_zip64=True) as part:
                shutil.copyfileobj(source, part, _BLOCK)


def differs_from_packed(path: Path, scratch: Path) -> bool:
    """Tell whether a zip file differs anywhere from what `pack` makes of its content.

    Parameters
    ----------
    path
        The zip file.
    scratch
        An empty folder for its content.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(scratch)
    except _DAMAGED:
        return True
    with path.open("rb") as stream:
        comparison = _Comparison(stream)
        _pack(scratch, cast(Any, comparison))
        return comparison.differs or bool(stream.read(1))


class _Forwards:
    """A stream that can only be written to."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, data: bytes) -> int:
        self._stream.write(data)
        return len(data)

    def flush(self) -> None:
        pass


class _Comparison:
    """Takes what would be written, and compares it with what is there."""

    def __init__(self, there: IO[bytes]) -> None:
        self._there, self.differs = there, False

    def write(self, data: bytes) -> int:
        self.differs |= self._there.read(len(data)) != bytes(data)
        return len(data)

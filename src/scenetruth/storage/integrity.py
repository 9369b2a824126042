"""Whether a store is as it was written: a seal over its metadata and files, and a checksum in every chunk."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path, PurePath
from typing import Any

from scenetruth.errors import StoreError

__all__ = ["SEAL", "check_seal", "is_part", "seal"]

SEAL = "content"
"""Attribute of a store that holds its seal."""

_ROOT = "zarr.json"
_BLANK = "0" * 64


def seal(path: Path) -> None:
    """Put a seal on a store: the number of its files, the bytes of its chunks, and a digest.

    The digest covers every byte of metadata, and the name and size of every other file; these carry checksums of their
    own. Of the file that holds the digest itself, it takes the digest as zeros.
    """
    root = path / _ROOT
    metadata = json.loads(root.read_text(encoding="utf-8"))
    metadata["attributes"][SEAL] = {**_count(path), "sha256": _BLANK}
    blank = json.dumps(metadata, indent=2, ensure_ascii=True).encode()
    root.write_bytes(blank.replace(_BLANK.encode(), _digest(path, blank).encode(), 1))


def check_seal(path: Path, attributes: dict[str, Any]) -> None:
    """Refuse a store whose metadata or whose files have changed since it was sealed.

    Parameters
    ----------
    path
        The store.
    attributes
        Its attributes.

    Raises
    ------
    StoreError
        If it has; says what.
    """
    sealed = attributes.get(SEAL)
    if not isinstance(sealed, dict):
        raise StoreError(path, "carries no seal, so that nobody can tell whether it is whole; make it again")
    counted = {name: sealed.get(name) for name in ("files", "bytes")}
    found = _count(path)
    if counted != found:
        message = f"is damaged or cut short: sealed with {_told(counted)}, but it holds {_told(found)}; make it again"
        raise StoreError(path, message)
    root, digest = (path / _ROOT).read_bytes(), str(sealed.get("sha256"))
    if digest != _digest(path, root.replace(digest.encode(), _BLANK.encode(), 1)):
        message = "is damaged: its metadata, or the names or sizes of its files, have changed; make it again"
        raise StoreError(path, message)


def _told(count: dict[str, Any]) -> str:
    return f"{count['files']} files and {count['bytes']} bytes of chunks"


def is_part(relative: PurePath) -> bool:
    """Tell whether a path inside a store is that of a file which stores consist of."""
    return relative.name == _ROOT or (len(relative.parts) > 2 and relative.parts[1] == "c")


def _files(path: Path) -> list[Path]:
    found = (file for file in path.rglob("*") if is_part(file.relative_to(path)) and file.is_file())
    return sorted(file for file in found if file != path / _ROOT)


def _count(path: Path) -> dict[str, int]:
    files = _files(path)
    return {"files": len(files), "bytes": sum(file.stat().st_size for file in files if file.name != _ROOT)}


def _digest(path: Path, root: bytes) -> str:
    found = hashlib.sha256(root)
    for file in _files(path):
        found.update(file.relative_to(path).as_posix().encode() + b"\0")
        found.update(file.read_bytes() if file.name == _ROOT else str(file.stat().st_size).encode())
    return found.hexdigest()

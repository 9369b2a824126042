"""Whether a store is as it was written: a seal over its metadata and files, and a checksum in every chunk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from scenetruth.errors import StoreError
from scenetruth.storage.store_files import ROOT, StoreFiles, files_of

__all__ = ["SEAL", "check_seal", "seal"]

SEAL = "content"
"""Attribute of a store that holds its seal."""

_BLANK = "0" * 64


def seal(path: Path) -> None:
    """Put a seal on a store: the number of its files, the bytes of its chunks, and a digest.

    The digest covers every byte of metadata, and the name and size of every other file; these carry checksums of their
    own. Of the file that holds the digest itself, it takes the digest as zeros.
    """
    files = files_of(path)
    sizes = files.sizes()
    metadata = json.loads(files.read(ROOT))
    metadata["attributes"][SEAL] = {**_count(sizes), "sha256": _BLANK}
    blank = json.dumps(metadata, indent=2, ensure_ascii=True).encode()
    (path / ROOT).write_bytes(blank.replace(_BLANK.encode(), _digest(files, sizes, blank).encode(), 1))


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
    files = files_of(path)
    sizes = files.sizes()
    found = _count(sizes)
    if counted != found:
        message = f"is damaged or cut short: sealed with {_told(counted)}, but it holds {_told(found)}; make it again"
        raise StoreError(path, message)
    root, digest = files.read(ROOT), str(sealed.get("sha256"))
    if digest != _digest(files, sizes, root.replace(digest.encode(), _BLANK.encode(), 1)):
        message = "is damaged: its metadata, or the names or sizes of its files, have changed; make it again"
        raise StoreError(path, message)


def _told(count: dict[str, Any]) -> str:
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

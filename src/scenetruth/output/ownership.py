"""Ownership of existing results: only those written by scenetruth may be replaced."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Claim", "OwnershipResult", "claim_file", "claim_folder", "claim_pictures", "describe_foreign_files"]


@dataclass(frozen=True)
class OwnershipResult:
    """Result of a claim of an existing file or directory.

    ``refusal``: Why it may not be replaced; empty if it may.
    ``foreign``: Foreign names in the directory, which are kept.
    """

    refusal: str = ""
    foreign: tuple[str, ...] = ()


Claim = Callable[[Path], OwnershipResult]
"""Test of an existing file or directory for ownership."""

_SHOWN = 5
_HEAD_BYTES = 4096


def claim_file(path: Path) -> OwnershipResult:
    """Claim a file with a name given by scenetruth."""
    return OwnershipResult("is a directory, not a file written by scenetruth") if path.is_dir() else OwnershipResult()


def claim_pictures(path: Path, names: Callable[[str], bool] | None = None) -> OwnershipResult:
    """Claim a directory of images."""
    if not path.is_dir():
        return OwnershipResult("is a file, and not a directory of images written by scenetruth")
    foreign = [
        entry.name
        for entry in path.iterdir()
        if entry.is_symlink() or not entry.is_file() or not (names(entry.name) if names else _is_drawn(entry))
    ]
    return OwnershipResult(describe_foreign_files(foreign)) if foreign else OwnershipResult()


def claim_folder(sign: str, *names: str) -> Claim:
    """Return a claim for directories that contain a certain file."""

    def claim(path: Path) -> OwnershipResult:
        if not (path / sign).is_file():
            return OwnershipResult("is a directory that scenetruth did not write" if path.is_dir() else "is a file")
        entries = [entry for entry in path.iterdir() if entry.name not in (sign, *names)]
        return OwnershipResult(
            foreign=tuple(entry.name for entry in entries if not entry.is_file() or not _is_drawn(entry))
        )

    return claim


def _is_drawn(file: Path) -> bool:
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
        # PDF files name their producer at the end.
        stream.seek(max(0, file.stat().st_size - _HEAD_BYTES))
        return b"scenetruth" in head or b"scenetruth" in stream.read()


def describe_foreign_files(foreign: Collection[str]) -> str:
    """Return the refusal of a directory with foreign files."""
    shown = ", ".join(sorted(foreign)[:_SHOWN]) + (", ..." if len(foreign) > _SHOWN else "")
    return f"contains files not written by scenetruth ({shown}); move it elsewhere first"

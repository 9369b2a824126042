"""Which existing results may be replaced: those scenetruth wrote, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Claim", "OwnershipResult", "claim_file", "claim_folder", "claim_pictures", "describe_foreign_files"]


@dataclass(frozen=True)
class OwnershipResult:
    """What a claim found out about an existing file or folder.

    ``refusal``: Why it may not be replaced; empty if it may.
    ``foreign``: Names in the folder that are not ours; they stay.
    """

    refusal: str = ""
    foreign: tuple[str, ...] = ()


Claim = Callable[[Path], OwnershipResult]
"""Looks at an existing file or folder, and tells what of it is ours."""

_SHOWN = 5
_HEAD_BYTES = 4096


def claim_file(path: Path) -> OwnershipResult:
    """Claim a file whose name is ours."""
    return OwnershipResult("is a folder, and not a file that scenetruth wrote") if path.is_dir() else OwnershipResult()


def claim_pictures(path: Path, names: Callable[[str], bool] | None = None) -> OwnershipResult:
    """Claim a folder of pictures."""
    if not path.is_dir():
        return OwnershipResult("is a file, and not a folder of pictures that scenetruth wrote")
    foreign = [
        entry.name
        for entry in path.iterdir()
        if entry.is_symlink() or not entry.is_file() or not (names(entry.name) if names else _is_drawn(entry))
    ]
    return OwnershipResult(describe_foreign_files(foreign)) if foreign else OwnershipResult()


def claim_folder(sign: str, *names: str) -> Claim:
    """Return a claim of folders that hold a certain file."""

    def claim(path: Path) -> OwnershipResult:
        if not (path / sign).is_file():
            return OwnershipResult("is a folder that scenetruth did not write" if path.is_dir() else "is a file")
        entries = [entry for entry in path.iterdir() if entry.name not in (sign, *names)]
        return OwnershipResult(
            foreign=tuple(entry.name for entry in entries if not entry.is_file() or not _is_drawn(entry))
        )

    return claim


def _is_drawn(file: Path) -> bool:
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
        # PDF files say at their end who made them.
        stream.seek(max(0, file.stat().st_size - _HEAD_BYTES))
        return b"scenetruth" in head or b"scenetruth" in stream.read()


def describe_foreign_files(foreign: Collection[str]) -> str:
    """Return the refusal of a folder that holds foreign files."""
    shown = ", ".join(sorted(foreign)[:_SHOWN]) + (", ..." if len(foreign) > _SHOWN else "")
    return f"holds what scenetruth did not write ({shown}); move it elsewhere first"

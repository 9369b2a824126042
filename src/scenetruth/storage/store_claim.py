"""What of an existing store may be replaced."""

from __future__ import annotations

from pathlib import Path

from scenetruth.placing import Claimed, holds
from scenetruth.storage.integrity import is_part

__all__ = ["claim_store", "is_store"]


def claim_store(path: Path) -> Claimed:
    """Claim a store: a folder with a data set of ours and nothing else."""
    if not path.is_dir():
        return Claimed("is a file, and not a store that scenetruth wrote")
    if not is_store(path):
        return Claimed("is a folder that scenetruth did not write")
    foreign = [
        relative.as_posix()
        for relative in (file.relative_to(path) for file in path.rglob("*") if not file.is_dir() or file.is_symlink())
        if not is_part(relative)
    ]
    return Claimed(holds(foreign)) if foreign else Claimed()


def is_store(path: Path) -> bool:
    """Tell whether a folder looks like a store that scenetruth wrote, perhaps damaged since."""
    try:
        return b'"scenetruth"' in (path / "zarr.json").read_bytes()
    except OSError:
        return False

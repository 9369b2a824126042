"""What of an existing store may be replaced."""

from __future__ import annotations

from pathlib import Path

from scenetruth.placing import Claimed, holds
from scenetruth.storage.store_files import ROOT, files_of, is_zip_name

__all__ = ["claim_store", "is_store"]


def claim_store(path: Path) -> Claimed:
    """Claim a store: a folder or a zip file with a data set of ours and nothing else."""
    if is_zip_name(path) == path.is_dir() or not is_store(path):
        return Claimed("is not a store that scenetruth wrote")
    foreign = files_of(path).foreign()
    return Claimed(holds(foreign)) if foreign else Claimed()


def is_store(path: Path) -> bool:
    """Tell whether a folder or a zip file looks like a store that scenetruth wrote, perhaps damaged since."""
    try:
        return b'"scenetruth"' in files_of(path).read(ROOT)
    except OSError:
        return False

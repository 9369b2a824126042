"""Estimates written to stores, frame by frame where the method can."""

from __future__ import annotations

from pathlib import Path

from scenetruth.estimators import Estimation
from scenetruth.storage import StoreWriter, write_store

__all__ = ["write_estimate"]


def write_estimate(work: Estimation, path: Path, *, zipped: bool = False) -> None:
    """Make an estimate, and write it to a store that does not exist yet.

    Parameters
    ----------
    work
        What is to be estimated.
    path
        The store; `write_aside` gives such paths.
    zipped
        Whether it is one zip file.
    """
    blank = work.blank()
    if blank is None:
        write_store(work.estimate(), path, zipped=zipped)
        return
    with StoreWriter(path, blank, zipped=zipped) as writer:
        writer.describe(work.fill(writer.put))

"""What of an existing folder an export may replace: the files that an earlier export says it wrote."""

from __future__ import annotations

import json
import os
from pathlib import Path

from scenetruth.placing import Claimed, holds

__all__ = ["MAKER", "SIGN", "claim_export"]

SIGN = "export.json"
"""The file in every export that tells what it is, and which files belong to it."""
MAKER = "scenetruth"


def claim_export(path: Path) -> Claimed:
    """Claim the folder of an earlier export; files of others stay, and inside its own folders they forbid it."""
    if not path.is_dir():
        return Claimed("is a file, and not the folder of an export")
    try:
        told = json.loads((path / SIGN).read_text(encoding="utf-8"))
        own = {SIGN, *map(str, told["files"])} if told["made_by"] == MAKER else None
    except (OSError, ValueError, KeyError, TypeError):
        own = None
    if own is None:
        return Claimed(f"is a folder without the {SIGN} of an export")
    folders = {name.split("/")[0] for name in own if "/" in name}
    foreign, inside = [], []
    for entry in path.iterdir():
        if entry.name in folders and entry.is_dir() and not entry.is_symlink():
            inside += [name for name in _files_below(entry, path) if name not in own]
        elif entry.name not in own or entry.is_symlink():
            foreign.append(entry.name)
    return Claimed(holds(inside)) if inside else Claimed(foreign=tuple(sorted(foreign)))


def _files_below(folder: Path, top: Path) -> list[str]:
    """Return everything but folders below a folder, by names that count from the top; links are not followed."""
    found = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        found += [(Path(place) / name).relative_to(top).as_posix() for name in (*files, *links)]
    return found

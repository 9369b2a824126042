"""Which file in a folder of results holds which quantity, of which frame."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from scenetruth.errors import Problem
from scenetruth.estimators.external.exchange.file_formats import ENDINGS

__all__ = ["NOTE_FILE", "QUANTITIES", "ResultFile", "find_results"]

QUANTITIES = {
    "depth": 1,
    "disparity": 1,
    "flow": 2,
    "velocity": 3,
    "depth_rate": 1,
    "depth_std": 1,
    "disparity_std": 1,
    "velocity_std": 3,
    "kind": 1,
}
"""What results may hold, and of how many components."""

NOTE_FILE = "results.json"
"""The file that tells frames, units and the method's name; it may be left out."""

_FRAME = re.compile(r"(?P<name>.+)_t(?P<t>[+-]?\d{1,6})")
# How much alike two names are of which one is taken for a slip of the other.
_NEAR = 0.75


@dataclass(frozen=True)
class ResultFile:
    """A file of results.

    Parameters
    ----------
    path
        The file.
    name
        The quantity.
    t
        The frame; None if the file holds one frame or more, and its name does not say which.
    """

    path: Path
    name: str
    t: int | None


def find_results(folder: Path, problems: list[Problem]) -> dict[str, list[ResultFile]]:
    """Return the files of every quantity, those that can be told apart; note what is wrong.

    Folders in the folder, and files with endings that are not read, are left alone, unless they are named like a
    quantity.

    Parameters
    ----------
    folder
        The folder.
    problems
        Where to note what is wrong.
    """
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "is not there: nothing was written"
        problems.append(Problem(str(folder), what))
        return {}
    found: dict[str, list[ResultFile]] = defaultdict(list)
    bad = len(problems)
    for path in sorted(folder.iterdir()):
        item = _result_in(path, problems)
        if item is not None:
            found[item.name].append(item)
    if not found and len(problems) == bad:
        wanted = "depth.npy, disparity.npy, flow.npy or velocity.npy"
        there = sorted(path.name for path in folder.iterdir())[:10]
        problems.append(Problem(str(folder), f"holds no results: at least one is needed of {wanted}", there))
    return {name: items for name, items in found.items() if _one_of_each(name, items, problems)}


def _result_in(path: Path, problems: list[Problem]) -> ResultFile | None:
    stem, ending = path.name, ""
    # Stores are folders, all else are files.
    if path.suffix.lower() in ENDINGS and path.is_dir() == (path.suffix.lower() == ".zarr"):
        stem, ending = path.stem, path.suffix
    if path.name.startswith("estimate.zarr"):
        message = "whole estimates are not read here; write its maps as .npy or NAME.zarr, or use scenetruth.load"
        problems.append(Problem(path.name, message))
        return None
    framed = _FRAME.fullmatch(stem) if ending else None
    name = framed["name"] if framed else stem
    if not ending:
        name = stem.partition(".")[0]
        if path.is_file() and (_FRAME.fullmatch(name) or {"name": name})["name"] in QUANTITIES:
            message = f"is in a form that is not read; write {' or '.join(ENDINGS)}"
            problems.append(Problem(path.name, message))
        return None
    if name not in QUANTITIES:
        near = difflib.get_close_matches(name.lower(), QUANTITIES, n=1, cutoff=_NEAR)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(QUANTITIES)}."
        problems.append(Problem(path.name, f"has a name that means nothing; {hint} Put other files in a sub-folder"))
        return None
    if ending not in ENDINGS:
        problems.append(Problem(path.name, f"its ending must be in small letters: '{ending.lower()}'"))
        return None
    if ending == ".flo" and name != "flow":
        problems.append(Problem(path.name, "files .flo hold flow only; write .npy or .pfm"))
        return None
    if framed is None:
        return ResultFile(path, name, None)
    t = int(framed["t"])
    if framed["t"] != f"{t:+d}":
        problems.append(Problem(path.name, f"frames are written with their sign: {name}_t{t:+d}{ending}"))
        return None
    return ResultFile(path, name, t)


def _one_of_each(name: str, items: list[ResultFile], problems: list[Problem]) -> bool:
    """Tell whether no two files hold the same."""
    names = ", ".join(item.path.name for item in items)
    frames = [item.t for item in items]
    if len(items) > 1 and (None in frames or len(set(frames)) < len(frames)):
        problems.append(Problem(name, f"is there twice, and which one counts is open: {names}"))
        return False
    return True

"""The files in a folder of results.

Their formats (.npy, .npz, .pfm, .flo, .zarr), and the quantity and frame of each.
"""

from __future__ import annotations

import difflib
import re
import struct
import warnings
import zipfile
import zlib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem

__all__ = ["METADATA_FILE", "QUANTITIES", "ResultFile", "find_results", "read_map"]


Array = NDArray[Any]

_PFM_HEAD = re.compile(rb"(P[Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.0-9eE]{1,30})(?:\r\n|\s)")
_FLO_TAG = 202021.25
# Larger flows are unknown: Middlebury's rule.
_FLO_INVALID = 1e9


def read_map(file: Path, name: str) -> Array:
    """Return the array of a file; what its format calls unknown is NaN.

    Returns: As it was written, of any type and shape; of .pfm (y, x) or (3, y, x), of .flo (2, y, x).
    """
    try:
        return ENDINGS[file.suffix](file, name)
    except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, struct.error) as error:
        msg = f"cannot be read: {' '.join(str(error).split()) or type(error).__name__}"
        raise ValueError(msg) from error


def _npy(file: Path, name: str) -> Array:
    with file.open("rb") as opened:
        if opened.read(6) != b"\x93NUMPY":
            msg = "is no .npy file: it does not begin as one; write it by numpy.save"
            raise ValueError(msg)
    try:
        # A header may promise more than there is: nothing is allocated for it.
        found = np.load(file, mmap_mode="r", allow_pickle=False)
    except ValueError as error:
        raise ValueError(_describe_error(error)) from error
    return np.array(found)


def _npz(file: Path, name: str) -> Array:
    with zipfile.ZipFile(file) as packed:
        largest = max((item.file_size for item in packed.infolist()), default=0)
    if largest > _MOST_BYTES:
        msg = f"holds an array of {largest / 1e9:.3g} GB unpacked; write it as .npy"
        raise ValueError(msg)
    try:
        with np.load(file, allow_pickle=False) as packed:
            names = list(packed.files)
            if name not in names and len(names) != 1:
                msg = f"must hold one array, or one named '{name}'; it holds {', '.join(names) or 'none'}"
                raise ValueError(msg)
            return np.asarray(packed[name if name in names else names[0]])
    except ValueError as error:
        raise ValueError(_describe_error(error)) from error


# An archive of a few bytes may unpack to any size.
_MOST_BYTES = 32e9


def _describe_error(error: ValueError) -> str:
    text = " ".join(str(error).split())
    if "object" in text.lower():
        return "holds Python objects, not numbers; write an array of float32"
    return text if text.startswith("must hold") else f"cannot be read: {text}"


def _pfm(file: Path, name: str) -> Array:
    data = file.read_bytes()
    head = _PFM_HEAD.match(data)
    if head is None:
        msg = "is no .pfm file: it must begin with Pf or PF, width, height and -1.0"
        raise ValueError(msg)
    kind, width, height, scale = head.group(1), int(head.group(2)), int(head.group(3)), head.group(4)
    channels = 3 if kind == b"PF" else 1
    if (order := {1.0: ">f4", -1.0: "<f4"}.get(_number(scale))) is None:
        msg = "has a scale of other size than 1: write -1.0, and values in their units"
        raise ValueError(msg)
    values = _floats(data, head.end(), (height, width, channels), order)
    # Rows are stored from the bottom up.
    values = np.moveaxis(values[::-1], -1, 0)
    values = np.where(values == np.inf, np.float32(np.nan), values)
    return values if channels == 3 else values[0]


def _number(text: bytes) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _flo(file: Path, name: str) -> Array:
    data = file.read_bytes()
    if len(data) < 12 or struct.unpack("<f", data[:4])[0] != _FLO_TAG:
        msg = "is no .flo file: it must begin with the tag 202021.25, float32, little endian"
        raise ValueError(msg)
    width, height = struct.unpack("<ii", data[4:12])
    flow = np.moveaxis(_floats(data, 12, (height, width, 2), "<f4"), -1, 0)
    with np.errstate(invalid="ignore"):
        known = (np.abs(flow) <= _FLO_INVALID).all(axis=0)
    return np.where(known, flow, np.float32(np.nan))


def _floats(data: bytes, first: int, shape: tuple[int, int, int], order: str) -> Array:
    height, width, channels = shape
    needed, found = 4 * height * width * channels, len(data) - first
    if min(shape) < 1 or needed != found:
        values = f"{width} x {height} pixels of {channels} values"
        msg = f"holds {found} bytes behind its head, but {values} take {needed}"
        raise ValueError(msg)
    return np.frombuffer(data, dtype=order, offset=first).reshape(shape).astype(np.float32)


def _zarr(file: Path, name: str) -> Array:
    import zarr

    try:
        # What is not yet in its specification is no concern of who reads.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = zarr.open(file, mode="r")
            if isinstance(found, zarr.Group):
                names = sorted(found.array_keys())
                if name not in names and len(names) != 1:
                    msg = f"must hold one array, or one named '{name}'; it holds {', '.join(names) or 'none'}"
                    raise ValueError(msg)
                found = found[name if name in names else names[0]]
            if found.nbytes > _MOST_BYTES:
                msg = f"holds an array of {found.nbytes / 1e9:.3g} GB unpacked; write it as .npy"
                raise ValueError(msg)
            return np.asarray(found[...])
    except Exception as error:  # a broken store raises almost anything
        text = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            text if text.startswith(("must hold", "holds an array")) else f"cannot be read: {text}"
        ) from error


ENDINGS = {".npy": _npy, ".npz": _npz, ".pfm": _pfm, ".flo": _flo, ".zarr": _zarr}
"""What reads each ending."""


QUANTITIES = {
    "depth": 1,
    "disparity": 1,
    "flow": 2,
    "velocity": 3,
    "depth_rate": 1,
    "depth_std": 1,
    "disparity_std": 1,
    "velocity_std": 3,
    "status": 1,
}
"""What results may hold, and of how many components."""

METADATA_FILE = "results.json"
"""The file that tells frames, units and the method's name; it may be left out."""

_FRAME = re.compile(r"(?P<name>.+)_t(?P<t>[+-]?\d{1,6})")
# How much alike two names are of which one is taken for a slip of the other.
_NEAR = 0.75


@dataclass(frozen=True)
class ResultFile:
    """A file of results.

    ``path``: The file.
    ``name``: The quantity.
    ``t``: The frame; None if the file holds one frame or more, and its name does not say which.
    """

    path: Path
    name: str
    t: int | None


def find_results(folder: Path, problems: list[Problem]) -> dict[str, list[ResultFile]]:
    """Return the files of every quantity, those that can be told apart; note what is wrong.

    Folders in the folder, and files with endings that are not read, are left alone, unless they are named like a
    quantity.
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
    return {name: items for name, items in found.items() if _are_unique(name, items, problems)}


def _result_in(path: Path, problems: list[Problem]) -> ResultFile | None:
    stem, ending = path.name, ""
    # Stores are folders, all else are files.
    if path.suffix.lower() in ENDINGS and path.is_dir() == (path.suffix.lower() == ".zarr"):
        stem, ending = path.stem, path.suffix
    if path.name.startswith("estimate.zarr"):
        message = "whole estimates are not read here; write its maps as .npy or NAME.zarr, or use scenetruth.load_store"
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


def _are_unique(name: str, items: list[ResultFile], problems: list[Problem]) -> bool:
    """Tell whether no two files hold the same."""
    names = ", ".join(item.path.name for item in items)
    frames = [item.t for item in items]
    if len(items) > 1 and (None in frames or len(set(frames)) < len(frames)):
        problems.append(Problem(name, f"is there twice, and which one counts is open: {names}"))
        return False
    return True

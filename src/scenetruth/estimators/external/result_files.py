"""Files of a results folder: formats (.npy, .npz, .pfm, .flo, .zarr), quantities and frames."""

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
_FLO_INVALID = 1e9  # larger flows are invalid, as in the Middlebury format


def read_map(file: Path, name: str) -> Array:
    """Return the array of a file as written, invalid values as NaN; .pfm is (y, x) or (3, y, x), .flo is (2, y, x)."""
    try:
        return ENDINGS[file.suffix](file, name)
    except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, struct.error) as error:
        msg = f"cannot be read: {' '.join(str(error).split()) or type(error).__name__}"
        raise ValueError(msg) from error


def _npy(file: Path, name: str) -> Array:
    with file.open("rb") as opened:
        if opened.read(6) != b"\x93NUMPY":
            msg = "is not a .npy file; write it with numpy.save"
            raise ValueError(msg)
    try:
        # Memory-mapped, because a header may declare more data than the file contains.
        found = np.load(file, mmap_mode="r", allow_pickle=False)
    except ValueError as error:
        raise ValueError(_describe_error(error)) from error
    return np.array(found)


def _npz(file: Path, name: str) -> Array:
    with zipfile.ZipFile(file) as packed:
        largest = max((item.file_size for item in packed.infolist()), default=0)
    if largest > _MOST_BYTES:
        msg = f"contains an array of {largest / 1e9:.3g} GB unpacked; write it as .npy"
        raise ValueError(msg)
    try:
        with np.load(file, allow_pickle=False) as packed:
            names = list(packed.files)
            if name not in names and len(names) != 1:
                msg = f"must contain one array, or one named '{name}'; got {', '.join(names) or 'none'}"
                raise ValueError(msg)
            return np.asarray(packed[name if name in names else names[0]])
    except ValueError as error:
        raise ValueError(_describe_error(error)) from error


_MOST_BYTES = 32e9  # a small archive may expand to any size


def _describe_error(error: ValueError) -> str:
    text = " ".join(str(error).split())
    if "object" in text.lower():
        return "contains Python objects, not numbers; write an array of float32"
    return text if text.startswith("must contain") else f"cannot be read: {text}"


def _pfm(file: Path, name: str) -> Array:
    data = file.read_bytes()
    head = _PFM_HEAD.match(data)
    if head is None:
        msg = "is not a .pfm file: it must begin with Pf or PF, width, height and -1.0"
        raise ValueError(msg)
    kind, width, height, scale = head.group(1), int(head.group(2)), int(head.group(3)), head.group(4)
    channels = 3 if kind == b"PF" else 1
    if (order := {1.0: ">f4", -1.0: "<f4"}.get(_number(scale))) is None:
        msg = "has a scale other than 1; write -1.0, and values in their units"
        raise ValueError(msg)
    values = _floats(data, head.end(), (height, width, channels), order)
    # Rows are stored from bottom to top.
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
        msg = "is not a .flo file: it must begin with the tag 202021.25, float32, little endian"
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
        msg = f"contains {found} bytes after its header, but {values} require {needed}"
        raise ValueError(msg)
    return np.frombuffer(data, dtype=order, offset=first).reshape(shape).astype(np.float32)


def _zarr(file: Path, name: str) -> Array:
    import zarr

    try:
        # Warnings about features outside the Zarr specification are irrelevant to reading.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = zarr.open(file, mode="r")
            if isinstance(found, zarr.Group):
                names = sorted(found.array_keys())
                if name not in names and len(names) != 1:
                    msg = f"must contain one array, or one named '{name}'; got {', '.join(names) or 'none'}"
                    raise ValueError(msg)
                found = found[name if name in names else names[0]]
            if found.nbytes > _MOST_BYTES:
                msg = f"contains an array of {found.nbytes / 1e9:.3g} GB unpacked; write it as .npy"
                raise ValueError(msg)
            return np.asarray(found[...])
    except Exception as error:  # a damaged store may raise anything
        text = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            text if text.startswith(("must contain", "contains an array")) else f"cannot be read: {text}"
        ) from error


ENDINGS = {".npy": _npy, ".npz": _npz, ".pfm": _pfm, ".flo": _flo, ".zarr": _zarr}
"""Reader of each file extension."""


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
"""Quantities of results, with their number of components."""

METADATA_FILE = "results.json"
"""Optional file with frames, units and the name of the method."""

_FRAME = re.compile(r"(?P<name>.+)_t(?P<t>[+-]?\d{1,6})")
_NEAR = 0.75  # similarity above which a name is regarded as a misspelling of another


@dataclass(frozen=True)
class ResultFile:
    """A results file: path, quantity, and frame, which is None if the file name does not specify it."""

    path: Path
    name: str
    t: int | None


def find_results(folder: Path, problems: list[Problem]) -> dict[str, list[ResultFile]]:
    """Return the files of every quantity, without ambiguous files; append problems, but not for unrelated files."""
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist: no output was written"
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
        problems.append(Problem(str(folder), f"contains no results; write at least one of {wanted}", there))
    return {name: items for name, items in found.items() if _are_unique(name, items, problems)}


def _result_in(path: Path, problems: list[Problem]) -> ResultFile | None:
    stem, ending = path.name, ""
    # Zarr stores are folders, all others are files.
    if path.suffix.lower() in ENDINGS and path.is_dir() == (path.suffix.lower() == ".zarr"):
        stem, ending = path.stem, path.suffix
    if path.name.startswith("estimate.zarr"):
        message = "estimate stores are not supported; write maps as .npy or NAME.zarr, or use scenetruth.load_store"
        problems.append(Problem(path.name, message))
        return None
    framed = _FRAME.fullmatch(stem) if ending else None
    name = framed["name"] if framed else stem
    if not ending:
        name = stem.partition(".")[0]
        if path.is_file() and (_FRAME.fullmatch(name) or {"name": name})["name"] in QUANTITIES:
            message = f"has an unsupported format; write {' or '.join(ENDINGS)}"
            problems.append(Problem(path.name, message))
        return None
    if name not in QUANTITIES:
        near = difflib.get_close_matches(name.lower(), QUANTITIES, n=1, cutoff=_NEAR)
        hint = f"did you mean '{near[0]}'?" if near else f"valid: {', '.join(QUANTITIES)}."
        problems.append(Problem(path.name, f"is not the name of a quantity; {hint} Put other files in a sub-folder"))
        return None
    if ending not in ENDINGS:
        problems.append(Problem(path.name, f"has an extension that must be in lower case: '{ending.lower()}'"))
        return None
    if ending == ".flo" and name != "flow":
        problems.append(Problem(path.name, ".flo files are for flow only; write .npy or .pfm"))
        return None
    if framed is None:
        return ResultFile(path, name, None)
    t = int(framed["t"])
    if framed["t"] != f"{t:+d}":
        problems.append(Problem(path.name, f"must have a signed frame number: {name}_t{t:+d}{ending}"))
        return None
    return ResultFile(path, name, t)


def _are_unique(name: str, items: list[ResultFile], problems: list[Problem]) -> bool:
    """Return whether no two files define the same quantity and frame; append a problem otherwise."""
    names = ", ".join(item.path.name for item in items)
    frames = [item.t for item in items]
    if len(items) > 1 and (None in frames or len(set(frames)) < len(frames)):
        problems.append(Problem(name, f"is defined by several files; keep one of {names}"))
        return False
    return True

"""Files of maps as programs write them: .npy, .npz, .pfm, .flo, and stores .zarr."""

from __future__ import annotations

import re
import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["ENDINGS", "read_map"]

Array = NDArray[Any]

_PFM_HEAD = re.compile(rb"(P[Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.0-9eE]{1,30})(?:\r\n|\s)")
_FLO_TAG = 202021.25
# Larger flows are unknown: Middlebury's rule.
_FLO_UNKNOWN = 1e9


def read_map(file: Path, name: str) -> Array:
    """Return the array of a file; what its format calls unknown is NaN.

    Parameters
    ----------
    file
        The file, or the folder of a store, with one of the `ENDINGS`.
    name
        The quantity, by which an array is found among several.

    Returns
    -------
    numpy.ndarray
        As it was written, of any type and shape; of .pfm (y, x) or (3, y, x), of .flo (2, y, x).

    Raises
    ------
    ValueError
        If it cannot be read; says why.
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
        raise ValueError(_told(error)) from error
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
        raise ValueError(_told(error)) from error


# An archive of a few bytes may unpack to any size.
_MOST_BYTES = 32e9


def _told(error: ValueError) -> str:
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
        known = (np.abs(flow) <= _FLO_UNKNOWN).all(axis=0)
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

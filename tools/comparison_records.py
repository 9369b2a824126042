"""Records of outputs: any result as a flat mapping from a key to a number, a text, a digest of an array, or a table.

A key has segments, "recordings / cube / variables:image". A segment "SECTION:NAME" is a name that may be renamed;
SECTION is a section of renames.yaml. Keys that begin with "prose" hold texts that are meant to be read.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import re
import tarfile
import traceback
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from comparison_renames import BETWEEN

__all__ = ["Records"]

_DEEPEST = 14
_PROSE_ATTRIBUTES = ("long_name", "description", "comment", "standard_name")
_WORD_LISTS = ("flag_meanings",)
_MOST_LISTED = 64
_HASH = re.compile(r"[0-9a-f]{16}")
# Times and amounts of memory in pages.
_AMOUNT = re.compile(r"(?<![\w.])\d[\d.,]*(?=[ \u00a0]?(s|ms|min|h|kB|MB|GB)\b)")
# Lines of pages that hold times or hashes of files with times.
_TIMED = re.compile(r"timings|run time|made-of|code-hash")
_LONG_LINE = 200
_DRAWN = (".html", ".md", ".svg", ".pdf")


class Records:
    """What one part of the comparison has recorded.

    Parameters
    ----------
    places
        Paths that are replaced in all texts, with what stands for them.
    keeps_arrays
        Whether arrays are kept beside their digests, so that the size of a difference can be computed.
    """

    def __init__(self, places: Mapping[str, str], *, keeps_arrays: bool = False) -> None:
        self.entries: dict[str, Any] = {}
        self.failures: dict[str, str] = {}
        self.arrays: list[np.ndarray[Any, Any]] = []
        self._places = sorted(places.items(), key=lambda item: -len(item[0]))
        self._keeps_arrays = keeps_arrays

    def put(self, key: str, value: Any) -> None:
        """Record a plain value."""
        if key in self.entries:
            number = 2
            while f"{key}{BETWEEN}again {number}" in self.entries:
                number += 1
            key = f"{key}{BETWEEN}again {number}"
        self.entries[key] = self.plain(value)

    def prose(self, key: str, text: Any) -> None:
        """Record a text that is meant to be read."""
        self.put(f"prose{BETWEEN}{key}", text)

    def digest(self, key: str, data: bytes, *, decoded: bool = False) -> None:
        """Record the digest of bytes; those of a file that is also decoded may differ by names alone."""
        self.put(f"bytes{BETWEEN}{key}" if decoded else key, f"{len(data)} bytes, sha256 {_sha(data)}")

    def neutral(self, text: str) -> str:
        """Return a text without the paths of this run."""
        for place, stands in self._places:
            text = text.replace(place, stands)
        return text

    def plain(self, value: Any) -> Any:
        """Return a value as JSON can hold it."""
        if value is None or isinstance(value, bool | int | float):
            return value
        if isinstance(value, str):
            return self.neutral(value)
        if isinstance(value, np.generic):
            return self.plain(value.item())
        if isinstance(value, Enum):
            return self.plain(value.value)
        if isinstance(value, np.ndarray):
            return self.plain(value.tolist())
        if isinstance(value, Mapping):
            return {str(self.plain(key)): self.plain(one) for key, one in value.items()}
        if isinstance(value, Set):
            return sorted((self.plain(one) for one in value), key=str)
        if isinstance(value, Sequence) and not isinstance(value, bytes):
            return [self.plain(one) for one in value]
        if type(value).__name__ in ("NAType", "NaTType"):
            return None
        return self.neutral(str(value))

    @contextmanager
    def warned(self, key: str) -> Iterator[None]:
        """Record the warnings of a block."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
        ours = [str(one.message) for one in caught if "scenetruth" in type(one.message).__module__]
        self.prose(f"{key}{BETWEEN}warnings", ours)

    @contextmanager
    def guarded(self, key: str) -> Iterator[None]:
        """Record the warnings of a block; what fails in it is recorded, and the part goes on."""
        try:
            with self.warned(key):
                yield
        except Exception as error:  # of any class: the rest of the part is recorded nevertheless
            self.failures[key] = self.neutral("".join(traceback.format_exception(error)[-4:]))

    def array(self, key: str, values: Any, dims: Sequence[str] = ()) -> None:
        """Record an array: dimensions, shape, type, digest of its bytes, and what describes a difference."""
        array = np.ascontiguousarray(values)
        text = array.dtype.kind in "UOST"
        data = json.dumps(self.plain(array)).encode() if text else array.tobytes()
        found: dict[str, Any] = {
            "dims": list(dims),
            "shape": list(array.shape),
            "dtype": "text" if text else str(array.dtype),
            "sha": _sha(data),
        }
        if text and array.size <= _MOST_LISTED:
            found["values"] = self.plain(array)
            found.pop("sha")
        elif array.dtype.kind in "iufb" and array.size:
            numbers = array[np.isfinite(array)].astype(np.float64)
            found["finite"] = int(numbers.size)
            if numbers.size:
                found |= {"min": float(numbers.min()), "max": float(numbers.max()), "mean": float(numbers.mean())}
            if self._keeps_arrays:
                found["kept"] = len(self.arrays)
                self.arrays.append(array)
        self.entries[key] = {"array": found}

    def table(self, key: str, frame: Any) -> None:
        """Record a table: its columns and rows, types of columns beside them."""
        index = frame.index
        if index.name is not None or index.dtype.kind not in "iu" or index.nlevels > 1:
            frame = frame.reset_index()
        names = [str(name) for name in frame.columns]
        rows = [self.plain(row) for row in frame.itertuples(index=False, name=None)]
        for name, dtype in zip(names, frame.dtypes, strict=True):
            self.put(f"{key}{BETWEEN}types{BETWEEN}columns:{name}", str(dtype))
        self.entries[key] = {"table": {"columns": names, "rows": rows}}

    def dataset(self, key: str, dataset: Any) -> None:
        """Record a data set of xarray: variables, coordinates, and all attributes."""
        for name, item in {**dataset.coords, **dataset.data_vars}.items():
            where = f"{key}{BETWEEN}variables:{name}"
            self.array(where, item.values, item.dims)
            self.put(f"{where}{BETWEEN}role", "coordinate" if name in dataset.coords else "variable")
            self._attributes(where, item.attrs)
        self._attributes(key, dataset.attrs)

    def _attributes(self, key: str, attributes: Mapping[str, Any]) -> None:
        for name, value in attributes.items():
            where = f"{key}{BETWEEN}attributes:{name}"
            if name in _PROSE_ATTRIBUTES:
                self.prose(where, value)
            elif name in _WORD_LISTS:
                self.put(where, str(value).split())
            else:
                self.flat(where, value)

    def flat(self, key: str, value: Any, sections: Sequence[str] = (), depth: int = 0) -> None:
        """Record any value; mappings, models and data classes by their keys and fields.

        Parameters
        ----------
        key
            Key of the value.
        value
            The value.
        sections
            Sections of the keys of nested mappings, from the outermost on; ``fields`` for all others.
        depth
            How deep the value lies in the first one.
        """
        section, inner = (sections[0], sections[1:]) if sections else ("fields", ())
        kind = f"{type(value).__module__}.{type(value).__name__}"
        if depth > _DEEPEST:
            self.put(key, f"deeper than {_DEEPEST}")
        elif kind.startswith("xarray.") and hasattr(value, "data_vars"):
            self.dataset(key, value)
        elif kind.startswith("xarray."):
            self.array(key, value.values, value.dims)
            self._attributes(key, value.attrs)
        elif kind.startswith("pandas.") and hasattr(value, "columns"):
            self.table(key, value)
        elif isinstance(value, np.ndarray):
            self.array(key, value)
        elif hasattr(value, "model_dump"):
            self.flat(key, value.model_dump(), sections, depth)
        elif isinstance(value, Mapping):
            if not value:
                self.put(key, {})
            for name, one in value.items():
                where = f"{key}{BETWEEN}{section}:{self.plain(name)}"
                if name in _PROSE_ATTRIBUTES and isinstance(one, str):
                    self.prose(where, one)
                else:
                    self.flat(where, one, inner, depth + 1)
        elif dataclasses.is_dataclass(value) and not isinstance(value, type):
            for one in dataclasses.fields(value):
                self.flat(f"{key}{BETWEEN}fields:{one.name}", getattr(value, one.name), (), depth + 1)
        elif isinstance(value, list | tuple) and _are_rows(value):
            self.entries[key] = {
                "table": {"columns": list(value[0]), "rows": self.plain([list(one.values()) for one in value])}
            }
        elif isinstance(value, list | tuple) and any(_is_deep(one) for one in value):
            for number, one in enumerate(value):
                self.flat(f"{key}{BETWEEN}{number}", one, sections, depth + 1)
        elif isinstance(value, str) and value[:1] in ("{", "[") and (decoded := _decoded(value)) is not None:
            self.flat(key, decoded, (), depth + 1)
        elif callable(value):
            self.put(key, "a callable")
        else:
            self.put(key, value)

    def folder(self, key: str, folder: Path) -> None:
        """Record all files of a folder, those in folders below too; of files that are named by a hash, the number."""
        hashed = 0
        for file in sorted(folder.rglob("*")):
            if any(_HASH.fullmatch(part.split(".")[0]) for part in file.relative_to(folder).parts):
                hashed += file.is_file()
            elif file.is_file():
                self.file(f"{key}{BETWEEN}files:{file.relative_to(folder).as_posix()}", file.name, file.read_bytes())
        self.put(f"{key}{BETWEEN}files named by a hash", hashed)

    def file(self, key: str, name: str, data: bytes) -> None:
        """Record a file: its content where the form is known and holds names, and its bytes."""
        suffix = Path(name).suffix.lower()
        self.put(f"{key}{BETWEEN}is there", True)
        if suffix in _DRAWN or (suffix == ".png" and _is_drawn(data)):
            text = self.neutral(data.decode("utf-8", "replace"))
            lines = [line for line in text.splitlines() if not _TIMED.search(line[:_LONG_LINE])]
            self.prose(key, _sha(_AMOUNT.sub("N", "\n".join(lines)).encode()))
            return
        if suffix == ".png":
            data, texts = _without_texts(data)
            if texts:
                self.prose(key, texts)
        decode = getattr(self, f"_read_{suffix.lstrip('.')}", None)
        decoded = False
        if decode is not None:
            try:
                decoded = decode(key, data) is None
            except (ValueError, KeyError, yaml.YAMLError, UnicodeDecodeError) as error:
                self.put(f"{key}{BETWEEN}not decoded", type(error).__name__)
        self.digest(key, data, decoded=decoded)

    def _read_json(self, key: str, data: bytes) -> None:
        self.flat(key, json.loads(data))

    def _read_jsonl(self, key: str, data: bytes) -> None:
        for number, line in enumerate(data.decode().splitlines()):
            self.flat(f"{key}{BETWEEN}{number}", json.loads(line))

    def _read_yaml(self, key: str, data: bytes) -> None:
        self.flat(key, yaml.safe_load(data.decode()))

    def _read_csv(self, key: str, data: bytes) -> None:
        import pandas as pd

        self.table(key, pd.read_csv(io.BytesIO(data), comment=None))

    def _read_parquet(self, key: str, data: bytes) -> None:
        import pyarrow.parquet as pq

        table = pq.read_table(io.BytesIO(data))
        for field in table.schema:
            self.put(f"{key}{BETWEEN}columns:{field.name}{BETWEEN}type", str(field.type))
        self.table(key, table.to_pandas())

    def _read_npz(self, key: str, data: bytes) -> None:
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            for name in found.files:
                where, values = f"{key}{BETWEEN}variables:{name}", found[name]
                text = str(values) if values.dtype.kind == "U" and values.ndim == 0 else ""
                if text[:1] == "{" and (decoded := _decoded(text)) is not None:
                    self.flat(where, decoded)
                else:
                    self.array(where, values)

    def _read_zip(self, key: str, data: bytes) -> None:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in sorted(archive.namelist()):
                self.file(f"{key}{BETWEEN}files:{name}", name, archive.read(name))

    def _read_tar(self, key: str, data: bytes) -> None:
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            for member in sorted(archive.getmembers(), key=lambda one: one.name):
                if (opened := archive.extractfile(member)) is not None:
                    self.file(f"{key}{BETWEEN}files:{member.name}", member.name, opened.read())

    def _read_exr(self, key: str, data: bytes) -> None:
        import tempfile

        import OpenEXR

        with tempfile.NamedTemporaryFile(suffix=".exr") as file:
            Path(file.name).write_bytes(data)
            with OpenEXR.File(file.name, separate_channels=True) as image:
                for name, channel in image.channels().items():
                    self.array(f"{key}{BETWEEN}variables:{name}", channel.pixels)

    def _read_ply(self, key: str, data: bytes) -> None:
        from plyfile import PlyData

        for element in PlyData.read(io.BytesIO(data)).elements:
            for item in element.properties:
                self.array(f"{key}{BETWEEN}{element.name}{BETWEEN}variables:{item.name}", element[item.name])

    def _read_dsp5(self, key: str, data: bytes) -> None:
        import h5py

        with h5py.File(io.BytesIO(data)) as file:
            for name in file:
                self.array(f"{key}{BETWEEN}variables:{name}", file[name][()])

    _read_flo5 = _read_dsp5


def _without_texts(data: bytes) -> tuple[bytes, list[str]]:
    """Return a PNG file without its chunks of text, and these texts."""
    kept, texts, place = data[:8], [], 8
    while place < len(data):
        end = place + 12 + int.from_bytes(data[place : place + 4], "big")
        if data[place + 4 : place + 8] in (b"tEXt", b"zTXt", b"iTXt"):
            texts.append(data[place + 8 : end - 4].decode("utf-8", "replace"))
        else:
            kept += data[place:end]
        place = end
    return kept, texts


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:20]


def _decoded(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return None


def _is_deep(value: Any) -> bool:
    """Return whether a value is no number, text or list of such."""
    if isinstance(value, list | tuple):
        return any(map(_is_deep, value))
    deep = isinstance(value, Mapping | np.ndarray) or hasattr(value, "model_dump") or hasattr(value, "data_vars")
    return deep or (dataclasses.is_dataclass(value) and not isinstance(value, type)) or hasattr(value, "columns")


def _are_rows(values: Sequence[Any]) -> bool:
    """Return whether values are mappings with the same names, to plain values: the rows of a table."""
    if not values or not all(isinstance(one, Mapping) and one for one in values):
        return False
    names = list(values[0])
    return all(list(one) == names and not any(map(_is_deep, one.values())) for one in values)


def _is_drawn(data: bytes) -> bool:
    """Return whether a PNG file is a plot of Matplotlib, which has words in it."""
    return b"Software\0Matplotlib" in data[:400]

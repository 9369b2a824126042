"""The catalogue on disk: parts as samples are made, one file when all are there; every file is whole."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.catalogue.columns import schema_of, table_of
from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.sampler import Sampler
from scenetruth.errors import StoreError
from scenetruth.placing import is_full_disk, write_aside

if TYPE_CHECKING:
    import pyarrow

__all__ = ["CatalogueWriter", "catalogued", "read_catalogue", "write_whole"]

_ROWS, _SECONDS = 1000, 60.0
"""A part is written when it has so many rows, or so long after the one before."""
_PART = re.compile(r"part-[0-9a-z-]+\.parquet")


class CatalogueWriter:
    """Writes rows of the catalogue in parts.

    Parameters
    ----------
    folder
        The data set.
    sampler
        Its recipe.
    label
        What distinguishes the parts of this run from those of others that work on the same data set.
    """

    def __init__(self, folder: DatasetFolder, sampler: Sampler, label: str = "1of1") -> None:
        self._folder, self._sampler, self._label = folder, sampler, label
        self._rows: list[Mapping[str, Any]] = []
        self._written = time.monotonic()
        self._next = 1 + max((int(name.rpartition("-")[2][:-8]) for name in self._own_parts()), default=-1)

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row; it is on disk after `flush`, or when enough have come together and there is room."""
        self._rows.append(row)
        if len(self._rows) >= _ROWS or time.monotonic() - self._written > _SECONDS:
            self.flush_if_there_is_room()

    def flush(self) -> None:
        """Write what has come together."""
        if self._rows:
            _write(
                table_of(self._rows, self._sampler),
                self._folder.parts / f"part-{self._label}-{self._next:06d}.parquet",
            )
            self._rows, self._next = [], self._next + 1
        self._written = time.monotonic()

    def flush_if_there_is_room(self) -> None:
        """Write what has come together, or keep it if the disk is full."""
        try:
            self.flush()
        except (OSError, StoreError) as error:
            if not is_full_disk(error):
                raise
            self._written = time.monotonic()

    def _own_parts(self) -> list[str]:
        return [path.name for path in _parts(self._folder) if path.name.startswith(f"part-{self._label}-")]


def catalogued(folder: DatasetFolder) -> set[int]:
    """Return the numbers of the samples that are in the catalogue."""
    import pyarrow.parquet as pq

    found: set[int] = set()
    for path in _files(folder):
        try:
            found.update(pq.read_table(path, columns=["sample"])["sample"].to_pylist())
        except (OSError, ValueError, KeyError) as error:
            raise StoreError(path, f"is damaged: {error}; remove it, it is made again from the samples") from error
    return found


def read_catalogue(folder: DatasetFolder, sampler: Sampler) -> pyarrow.Table:
    """Return all rows of the catalogue in order, each sample once."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = schema_of(sampler)
    tables = []
    for path in _files(folder):
        try:
            tables.append(pq.read_table(path).select(schema.names).cast(schema))
        except (OSError, ValueError, KeyError) as error:
            raise StoreError(path, f"is damaged: {error}; remove it, it is made again from the samples") from error
    whole = pa.concat_tables([schema.empty_table(), *tables]).sort_by("sample")
    return whole.take(_first_of_each(whole["sample"].to_pylist()))


def write_whole(folder: DatasetFolder, sampler: Sampler) -> None:
    """Put all parts together into one file, and remove them."""
    parts = _parts(folder)
    if not parts and folder.catalogue.exists():
        return
    _write(read_catalogue(folder, sampler), folder.catalogue)
    for path in parts:
        path.unlink(missing_ok=True)
    if folder.parts.is_dir() and not os.listdir(folder.parts):
        folder.parts.rmdir()


def _first_of_each(numbers: Iterable[int]) -> list[int]:
    seen: set[int] = set()
    return [place for place, number in enumerate(numbers) if not (number in seen or seen.add(number))]  # type: ignore[func-returns-value]


def _parts(folder: DatasetFolder) -> list[Path]:
    if not folder.parts.is_dir():
        return []
    return sorted(path for path in folder.parts.iterdir() if _PART.fullmatch(path.name))


def _files(folder: DatasetFolder) -> list[Path]:
    return [*([folder.catalogue] if folder.catalogue.exists() else []), *_parts(folder)]


def _write(table: pyarrow.Table, path: Path) -> None:
    import pyarrow.parquet as pq

    with write_aside(path, overwrite=True) as aside:
        pq.write_table(table, aside, compression="zstd")

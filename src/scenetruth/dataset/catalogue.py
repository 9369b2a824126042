"""The catalogue: one row per sample, and the scores of methods."""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.checksums import list_path, load_record, refuse_unlike_checksum, write_with_checksums
from scenetruth.dataset.layout import RECORDING, SCENE, TRUTH, DatasetFolder
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import STATISTICS
from scenetruth.errors import MachineError, Problem, StoreError
from scenetruth.output import is_full_disk

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow

    from scenetruth.scoring import Score

__all__ = [
    "FILES",
    "SCORES_REMEDY",
    "CatalogueWriter",
    "build_catalogue_table",
    "describe_remedy",
    "flatten_score",
    "list_catalogued",
    "list_parts",
    "load_scores",
    "merge_parts",
    "read_catalogue",
    "replace_catalogue",
    "require_parquet",
    "score_file",
    "write_scores",
]


FILES = {SCENE: "scene", RECORDING: "recording", TRUTH: "truth"}
"""Files of a sample, and their names in columns."""

_OBJECT_COLUMNS = ("image_share", "seen_by_all", "depth_min_mm", "depth_max_mm", "growth_median_per_hour")


def require_parquet() -> None:
    """Raise `MachineError` unless pyarrow, which reads and writes catalogues, can be imported."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        message = f"data sets need pyarrow, which cannot be imported ({error}): pip install 'scenetruth[datasets]'"
        raise MachineError([Problem("pyarrow", message)]) from error


def build_catalogue_schema(sampler: Sampler) -> pyarrow.Schema:
    """Return the schema of a recipe's catalogue."""
    import pyarrow as pa

    text, number, whole = pa.string(), pa.float64(), pa.int64()
    fields: list[tuple[str, Any]] = [
        ("sample", whole),
        ("draw", whole),
        ("step", pa.int32()),
        ("factor", text),
        ("split", text),
        ("base", pa.int32()),
        ("attempts", pa.int32()),
        ("rejected", pa.list_(text)),
        ("scene_seed", pa.int64()),
        ("scene_hash", text),
        ("recording_hash", text),
        ("backend", text),
        ("seconds", number),
        ("warnings", pa.list_(text)),
        ("bytes", whole),
    ]
    for name in FILES.values():
        fields += [(f"{name}_sha256", text), (f"{name}_bytes", whole)]
    fields += [(name, number) for name in STATISTICS]
    each = [
        ("name", text),
        *((part, number) for part in _OBJECT_COLUMNS),
    ]
    fields.append(("objects", pa.list_(pa.struct(each))))
    fields += [(f"value.{key}", number if numeric else text) for key, numeric in _values(sampler).items()]
    return pa.schema(fields)


def build_catalogue_table(rows: Iterable[Mapping[str, Any]], sampler: Sampler) -> pyarrow.Table:
    """Return contents of ``sample.json`` of samples, optionally with ``seconds``, as a table of the catalogue."""
    import pyarrow as pa

    numeric = _values(sampler)
    return pa.Table.from_pylist([_flat(row, numeric) for row in rows], schema=build_catalogue_schema(sampler))


def _values(sampler: Sampler) -> dict[str, bool]:
    found = {item.key: item.distribution.is_number for item in sampler.varied}
    for factor, _, value in sampler.ladders:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        found[factor] = found.get(factor, True) and number
    return found


def _flat(row: Mapping[str, Any], numeric: Mapping[str, bool]) -> dict[str, Any]:
    flat = {name: value for name, value in row.items() if name not in ("values", "statistics", "files")}
    files = row["files"]
    flat["bytes"] = sum(one["bytes"] for one in files.values())
    for file, name in FILES.items():
        flat[f"{name}_sha256"], flat[f"{name}_bytes"] = files[file]["sha256"], files[file]["bytes"]
    flat |= row["statistics"]
    for key, is_number in numeric.items():
        value = row["values"].get(key)
        flat[f"value.{key}"] = value if value is None else float(value) if is_number else _text(value)
    seconds = row.get("seconds")
    flat["seconds"] = None if seconds is None or math.isnan(seconds) else seconds
    return flat


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


SCORES_REMEDY = "remove the table, and estimate again: existing scores are collected"
_REGIONS = ("all", "interior")
_STATISTICS = ("bias", "rmse", "median_abs_error", "density", "rms_z", "coverage_2_std", "count")


def flatten_score(score: Score) -> dict[str, Any]:
    """Return a score as columns, such as ``interior.depth.rmse``."""
    return {
        f"{region}.{quantity}.{name}": found.get(name)
        for region in _REGIONS
        for quantity, found in score.regions.get(region, {}).items()
        for name in _STATISTICS
        if name in found
    }


def score_file(folder: DatasetFolder, method: str, number: int) -> Path:
    """Return the score file of one sample."""
    return folder.scores(method) / f"{number // 1000:05d}" / f"{number:08d}.json"


def write_scores(folder: DatasetFolder, method: str) -> None:
    """Merge the scores of all samples into one table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = []
    for path in sorted(folder.scores(method).glob("*/*.json")):
        if not re.fullmatch(r"[0-9]{8}", path.stem):
            continue
        try:
            rows.append(load_record(path.read_bytes()))
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(path, f"is damaged: {error}; remove it, and estimate again") from error
    if not rows:
        return
    names = list(dict.fromkeys(name for row in rows for name in row))
    schema = pa.schema([(name, pa.int64() if name == "sample" else pa.float64()) for name in names])
    table = pa.Table.from_pylist(rows, schema=schema)
    others = [folder.scores(method) / name for name in ("settings.json", "made_of.txt")]
    write_with_checksums(
        {folder.scores_table(method): lambda partial: pq.write_table(table, partial, compression="zstd")},
        also=[file for file in others if file.exists()],
    )


def load_scores(folder: DatasetFolder) -> dict[str, pd.DataFrame]:
    """Return the tables of all methods by name, indexed by ``sample``."""
    import pandas as pd

    found = {}
    for name in folder.scored():
        table = folder.scores_table(name)
        if table.exists():
            refuse_unlike_checksum(table, SCORES_REMEDY)
            found[name] = pd.read_parquet(table).set_index("sample")
    return found


_ROWS, _SECONDS = 1000, 60.0
"""Limits of rows and of seconds after which a part is written."""
_PART = re.compile(r"part-[0-9a-z-]+\.parquet")


class CatalogueWriter:
    """Writer of the catalogue in parts; ``label`` distinguishes the parts of concurrent runs."""

    def __init__(self, folder: DatasetFolder, sampler: Sampler, label: str = "1of1") -> None:
        self._folder, self._sampler, self._label = folder, sampler, label
        self._rows: list[Mapping[str, Any]] = []
        self._written = time.monotonic()
        self._next = 1 + max((int(name.rpartition("-")[2][:-8]) for name in self._own_parts()), default=-1)

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row; it is written by `flush`, or when enough rows have accumulated and the disk has space."""
        self._rows.append(row)
        if len(self._rows) >= _ROWS or time.monotonic() - self._written > _SECONDS:
            self.flush_if_there_is_room()

    def flush(self) -> None:
        """Write the accumulated rows."""
        if self._rows:
            _write(
                build_catalogue_table(self._rows, self._sampler),
                self._folder.parts / f"part-{self._label}-{self._next:06d}.parquet",
            )
            self._rows, self._next = [], self._next + 1
        self._written = time.monotonic()

    def flush_if_there_is_room(self) -> None:
        """Write the accumulated rows, or keep them if the disk is full."""
        try:
            self.flush()
        except (OSError, StoreError) as error:
            if not is_full_disk(error):
                raise
            self._written = time.monotonic()

    def _own_parts(self) -> list[str]:
        return [path.name for path in list_parts(self._folder) if path.name.startswith(f"part-{self._label}-")]


def list_catalogued(folder: DatasetFolder) -> set[int]:
    """Return the numbers of the samples in the catalogue."""
    require_parquet()
    import pyarrow.parquet as pq

    tables = _read_files(folder, lambda path: pq.read_table(path, columns=["sample"]))
    return {number for table in tables for number in table["sample"].to_pylist()}


def read_catalogue(folder: DatasetFolder, sampler: Sampler) -> pyarrow.Table:
    """Return all rows of the catalogue in order, each sample once."""
    require_parquet()
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = build_catalogue_schema(sampler)
    tables = _read_files(folder, lambda path: pq.read_table(path).select(schema.names).cast(schema))
    whole = pa.concat_tables([schema.empty_table(), *tables]).sort_by("sample")
    return whole.take(pa.array(_first_of_each(whole["sample"].to_pylist()), pa.int64()))


def _read_files(folder: DatasetFolder, read: Callable[[Path], pyarrow.Table]) -> list[pyarrow.Table]:
    """Return the tables of the catalogue or of its parts, also if a run merges the parts meanwhile."""
    paths = _files(folder)
    try:
        return [_read_file(folder, path, read) for path in paths]
    except StoreError:
        if _files(folder) == paths:
            raise
        return _read_files(folder, read)


def _read_file(folder: DatasetFolder, path: Path, read: Callable[[Path], pyarrow.Table]) -> pyarrow.Table:
    refuse_unlike_checksum(path, describe_remedy(folder))
    try:
        return read(path)
    except (OSError, ValueError, KeyError) as error:
        raise StoreError(path, f"is damaged: {error}; {describe_remedy(folder)}") from error


def describe_remedy(folder: DatasetFolder) -> str:
    """Return the remedy for a damaged catalogue."""
    return f"rebuild it from the samples: scenetruth dataset catalogue {folder.path}"


def merge_parts(folder: DatasetFolder, sampler: Sampler) -> None:
    """Merge all parts into one file, and remove them."""
    parts = list_parts(folder)
    if not parts and folder.catalogue.exists():
        return
    _write(read_catalogue(folder, sampler), folder.catalogue)
    _remove_parts(folder, parts)


def replace_catalogue(folder: DatasetFolder, table: pyarrow.Table, *, complete: bool) -> Path:
    """Replace the catalogue and its parts by a table; that of an incomplete data set becomes a part."""
    former = _files(folder)
    target = folder.catalogue if complete else folder.parts / "part-rebuilt-000000.parquet"
    _write(table, target)
    _remove_parts(folder, [path for path in former if path != target])
    return target


def _remove_parts(folder: DatasetFolder, parts: Iterable[Path]) -> None:
    for path in parts:
        path.unlink(missing_ok=True)
        list_path(path).unlink(missing_ok=True)
    if folder.parts.is_dir() and not os.listdir(folder.parts):
        folder.parts.rmdir()


def _first_of_each(numbers: Iterable[int]) -> list[int]:
    seen: set[int] = set()
    return [place for place, number in enumerate(numbers) if not (number in seen or seen.add(number))]  # type: ignore[func-returns-value]


def list_parts(folder: DatasetFolder) -> list[Path]:
    """Return the parts of the catalogue during generation, in the order of their names."""
    try:
        return sorted(path for path in folder.parts.iterdir() if _PART.fullmatch(path.name))
    except (FileNotFoundError, NotADirectoryError):
        return []


def _files(folder: DatasetFolder) -> list[Path]:
    # A run that ends writes the catalogue before it removes the parts.
    parts = list_parts(folder)
    return [*([folder.catalogue] if folder.catalogue.exists() else []), *parts]


def _write(table: pyarrow.Table, path: Path) -> None:
    import pyarrow.parquet as pq

    write_with_checksums({path: lambda partial: pq.write_table(table, partial, compression="zstd")})

"""Columns of the catalogue: one table for all parts, whatever was drawn."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.catalogue.statistics import STATISTICS
from scenetruth.dataset.folder import RECORDING, SCENE, TRUTH
from scenetruth.dataset.sampler import Sampler

if TYPE_CHECKING:
    import pyarrow

__all__ = ["FILES", "schema_of", "table_of"]

FILES = {SCENE: "scene", RECORDING: "recording", TRUTH: "truth"}
"""Files of a sample, and what columns call them."""

_OF_OBJECTS = ("image_share", "seen_by_all", "depth_min_mm", "depth_max_mm", "growth_median_per_hour")


def schema_of(sampler: Sampler) -> pyarrow.Schema:
    """Return the columns of a recipe's catalogue.

    Parameters
    ----------
    sampler
        The recipe. Values that are always numbers have columns of numbers, ``value.PATH``; others have their text, or
        their JSON.
    """
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
        *((part, number) for part in _OF_OBJECTS),
    ]
    fields.append(("objects", pa.list_(pa.struct(each))))
    fields += [(f"value.{key}", number if numeric else text) for key, numeric in _values(sampler).items()]
    return pa.schema(fields)


def table_of(rows: Iterable[Mapping[str, Any]], sampler: Sampler) -> pyarrow.Table:
    """Return rows of the catalogue as a table.

    Parameters
    ----------
    rows
        What ``sample.json`` says of samples, perhaps with ``seconds``.
    sampler
        The recipe.
    """
    import pyarrow as pa

    numeric = _values(sampler)
    return pa.Table.from_pylist([_flat(row, numeric) for row in rows], schema=schema_of(sampler))


def _values(sampler: Sampler) -> dict[str, bool]:
    """Return the keys of all values, and whether each is always a number."""
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

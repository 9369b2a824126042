"""Metadata of a data set in the Croissant format: publication, descriptions of columns, record sets."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from datetime import date as day
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from scenetruth.dataset.layout import RECORDING, SAMPLE, SCENE, TRUTH, DatasetFolder
from scenetruth.dataset.pages.page_text import format_label, format_title
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import STATISTICS
from scenetruth.errors import Problem, RecipeError

if TYPE_CHECKING:
    import pyarrow

__all__ = ["VALUE", "Publication", "build_croissant", "describe_column"]


@dataclass(frozen=True)
class Publication:
    """How a data set is published.

    ``version``: Its version: three numbers with points between them.
    ``date``: The day of its publication, as 2026-11-23; empty if it is not known yet.
    ``url``: Where it is to be found; empty if it is not known yet.
    """

    version: str = "1.0.0"
    date: str = ""
    url: str = ""

    def __post_init__(self) -> None:
        problems = []
        if not re.fullmatch(r"[0-9]+\.[0-9]+\.[0-9]+", self.version):
            problems.append(
                Problem("version", "must be three numbers with points between them, as 1.0.0", self.version)
            )
        if self.date and not _is_day(self.date):
            problems.append(Problem("published", "must be a day, as 2026-11-23", self.date))
        if self.url and not _is_address(self.url):
            problems.append(Problem("url", "must be an address that begins with https:// or http://", self.url))
        if problems:
            raise RecipeError(problems)


def _is_day(text: str) -> bool:
    try:
        return day.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.netloc) and text.isprintable() and " " not in text


VALUE = "value."
"""What names of columns with drawn values begin with."""
_FIXED = {
    "sample": "number of the sample, which names its folder",
    "draw": "number of the draw that it belongs to; all steps of a ladder share it",
    "step": "0 for the sample as it was drawn, then the steps of the ladders",
    "factor": "path of what the step changes; empty for step 0",
    "split": "name of its split; empty if there are none",
    "base": "number of the base scene in the recipe",
    "attempts": "how many draws it took until one was accepted",
    "rejected": "why the draws before were refused, in order",
    "scene_seed": "seed of textures, noise and stage errors",
    "scene_hash": "hash of everything in the scene that images and truth depend on",
    "recording_hash": "hash of that, and of the backend that rendered",
    "backend": "what rendered it",
    "seconds": "time that it took, in s; unlike all else it differs from run to run",
    "warnings": "warnings that its making gave",
    "bytes": "size of its files together",
    "shard": "number of the tar file that holds it",
    "objects": "what is seen of each object: name, share of the image, share of that which all cameras see, depths",
}
_FILES = {"scene": "scene.yaml", "recording": "recording.zarr.zip", "truth": "truth.zarr.zip"}
_FILE_COLUMNS = {"sha256": "SHA-256 of {}", "bytes": "size of {} in bytes"}


def describe_column(name: str, sampler: Sampler) -> str:
    """Return what a column of the catalogue holds."""
    if name.startswith(VALUE):
        key = name.removeprefix(VALUE)
        told = format_title(*format_label(key, sampler.bases[0].to_dict()))
        return f"what was drawn: {told}"
    if name in STATISTICS:
        return f"{STATISTICS[name]}; of the reference camera at the reference frame"
    file, _, what = name.rpartition("_")
    if file in _FILES and what in _FILE_COLUMNS:
        return _FILE_COLUMNS[what].format(_FILES[file])
    return _FIXED.get(name, name.replace("_", " "))


CATALOGUE = "catalogue"
"""Name of the set of records that the catalogue is."""
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_VERSION = "http://mlcommons.org/croissant/1.1"
_PARQUET, _YAML, _JSON, _ZIP, _TAR = (
    "application/x-parquet",
    "application/yaml",
    "application/json",
    "application/zip",
    "application/x-tar",
)


def build_croissant(
    folder: DatasetFolder, sampler: Sampler, table: pyarrow.Table, publication: Publication
) -> dict[str, Any]:
    """Return the metadata of a data set, ready for JSON."""
    recipe = sampler.recipe
    found: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": _VERSION,
        "name": recipe.name,
        "description": recipe.description or f"{recipe.count} rendered scenes with exact depth and 3D motion.",
        "license": recipe.licence,
        "citeAs": recipe.citation,
        "creator": [{"@type": "sc:Person", "name": name} for name in recipe.creators],
        "version": publication.version,
        "datePublished": publication.date,
        "url": publication.url,
        "keywords": ["synthetic images", "ground truth", "depth", "disparity", "optical flow", "scene flow"],
        "distribution": _distribution(folder, sampler),
        "recordSet": [_records(sampler, table)],
    }
    return {key: value for key, value in found.items() if value not in ("", [])}


def _distribution(folder: DatasetFolder, sampler: Sampler) -> list[dict[str, Any]]:
    files = [
        _file(
            folder.catalogue, CATALOGUE, "one row per sample: what was drawn, hashes, statistics of the truth", _PARQUET
        ),
        _file(folder.recipe, "recipe", "the recipe with its base scenes: makes the same data set again", _YAML),
        _file(folder.identity, "identity", "hash of the recipe, backend and versions", _JSON),
    ]
    if sampler.recipe.layout == "shards":
        return [*files, _set("shards", "shards/*.tar", "samples, many in one tar file", _TAR)]
    return [
        *files,
        _set("recordings", f"samples/*/*/{RECORDING}", "images of all cameras and frames, zarr in zip files", _ZIP),
        _set("truths", f"samples/*/*/{TRUTH}", "exact depth, disparity, flow and motion, zarr in zip files", _ZIP),
        _set("scenes", f"samples/*/*/{SCENE}", "scenes, enough to make each sample again", _YAML),
        _set("rows", f"samples/*/*/{SAMPLE}", "what the catalogue tells of each sample", _JSON),
    ]


def _file(path: Path, name: str, description: str, encoding: str) -> dict[str, Any]:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return {
        "@type": "cr:FileObject",
        "@id": path.name,
        "name": name,
        "description": description,
        "contentUrl": path.name,
        "contentSize": f"{path.stat().st_size} B",
        "encodingFormat": encoding,
        "sha256": digest,
    }


def _set(name: str, includes: str, description: str, encoding: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": description,
        "encodingFormat": encoding,
        "includes": includes,
    }


def _records(sampler: Sampler, table: pyarrow.Table) -> dict[str, Any]:
    import pyarrow as pa

    # Records of Croissant cannot hold a list of structures: what is told of objects is in the Parquet file alone.
    told = [entry for entry in table.schema if not pa.types.is_nested(entry.type) or _is_plain_list(entry.type)]
    fields = [_field(entry, sampler) for entry in told]
    return {
        "@type": "cr:RecordSet",
        "@id": CATALOGUE,
        "name": CATALOGUE,
        "description": _is_described_elsewhere(table, told),
        "key": {"@id": f"{CATALOGUE}/sample"},
        "field": fields,
    }


def _is_plain_list(kind: pyarrow.DataType) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_list(kind) and not pa.types.is_nested(kind.value_type))


def _is_described_elsewhere(table: pyarrow.Table, told: list[pyarrow.Field]) -> str:
    left_out = [name for name in table.schema.names if name not in {entry.name for entry in told}]
    more = f" The file has these columns besides, of lists of structures: {', '.join(left_out)}." if left_out else ""
    return f"One record per sample.{more}"


def _field(entry: pyarrow.Field, sampler: Sampler) -> dict[str, Any]:
    import pyarrow as pa

    listed = pa.types.is_list(entry.type)
    kind = entry.type.value_type if listed else entry.type
    found = {
        "@type": "cr:Field",
        "@id": f"{CATALOGUE}/{entry.name}",
        "name": entry.name,
        "description": describe_column(entry.name, sampler),
        "dataType": _type_of(kind),
        "source": {"fileObject": {"@id": "catalogue.parquet"}, "extract": {"column": entry.name}},
    }
    return found | ({"isArray": True, "arrayShape": "-1"} if listed else {})


def _type_of(kind: pyarrow.DataType) -> str:
    import pyarrow as pa

    if pa.types.is_floating(kind):
        return "cr:Float64"
    if pa.types.is_integer(kind):
        return "cr:Int64"
    return "sc:Boolean" if pa.types.is_boolean(kind) else "sc:Text"

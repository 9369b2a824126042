"""Metadata of a data set in the Croissant format: publication, descriptions of columns, record sets."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.layout import RECORDING, SAMPLE, SCENE, TRUTH, DatasetFolder
from scenetruth.dataset.pages.page_text import format_label, format_title
from scenetruth.dataset.recipe_model import RecipeModel, is_address, is_day
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import STATISTICS
from scenetruth.errors import Problem, RecipeError

if TYPE_CHECKING:
    import pyarrow

__all__ = ["VALUE", "Publication", "build_croissant", "cite", "describe_column"]


@dataclass(frozen=True)
class Publication:
    """Version (three numbers separated by dots), date such as 2026-11-23, and address; empty if undecided."""

    version: str = "1.0.0"
    date: str = ""
    url: str = ""

    def __post_init__(self) -> None:
        problems = []
        if not re.fullmatch(r"[0-9]+\.[0-9]+\.[0-9]+", self.version):
            problems.append(Problem("version", "must be three numbers separated by dots, such as 1.0.0", self.version))
        if self.date and not is_day(self.date):
            problems.append(Problem("published", "must be a date, such as 2026-11-23", self.date))
        if self.url and not is_address(self.url):
            problems.append(Problem("url", "must be an address that begins with https:// or http://", self.url))
        if problems:
            raise RecipeError(problems)


def cite(recipe: RecipeModel, publication: Publication) -> str:
    """Return the citation of a recipe; without one, its creators, name, version, date and address."""
    if recipe.citation:
        return recipe.citation
    by = f"{', '.join(recipe.creators)}: " if recipe.creators else ""
    issued = "".join(f", {text}" for text in (f"version {publication.version}", publication.date) if text)
    return (
        f"{by}{recipe.name}{issued}. Data set generated with scenetruth.{f' {publication.url}' * bool(publication.url)}"
    )


VALUE = "value."
"""Prefix of columns of drawn values."""
_FIXED = {
    "sample": "number of the sample, which is the name of its directory",
    "draw": "number of the draw; all steps of a paired series share it",
    "step": "0 for the sample as drawn, then the steps of the paired series",
    "factor": "path of the factor changed by the step; empty for step 0",
    "split": "name of its split; empty if there are none",
    "base": "number of the base scene in the recipe",
    "attempts": "number of draws until acceptance",
    "rejected": "reasons of the rejected draws, in order",
    "scene_seed": "seed of textures, noise and stage errors",
    "scene_hash": "hash of all parameters of the scene that determine images and truth",
    "recording_hash": "hash of the scene and of the rendering backend",
    "backend": "rendering backend",
    "seconds": "duration, in s; the only column that differs between runs",
    "warnings": "warnings of its generation",
    "bytes": "total size of its files",
    "shard": "number of the tar file that contains it",
    "objects": "visible part of each object: name, share of the image, share visible in all cameras, depths",
}
_FILES = {"scene": "scene.yaml", "recording": "recording.zarr.zip", "truth": "truth.zarr.zip"}
_FILE_COLUMNS = {"sha256": "SHA-256 of {}", "bytes": "size of {} in bytes"}


def describe_column(name: str, sampler: Sampler) -> str:
    """Return the description of a column of the catalogue."""
    if name.startswith(VALUE):
        key = name.removeprefix(VALUE)
        values = format_title(*format_label(key, sampler.bases[0].to_dict()))
        return f"drawn value: {values}"
    if name in STATISTICS:
        return f"{STATISTICS[name]}; reference camera, reference frame"
    file, _, what = name.rpartition("_")
    if file in _FILES and what in _FILE_COLUMNS:
        return _FILE_COLUMNS[what].format(_FILES[file])
    return _FIXED.get(name, name.replace("_", " "))


CATALOGUE = "catalogue"
"""Name of the record set of the catalogue."""
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
        "citeAs": cite(recipe, publication),
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
            folder.catalogue, CATALOGUE, "one row per sample: drawn values, hashes, statistics of the truth", _PARQUET
        ),
        _file(folder.recipe, "recipe", "the recipe including its base scenes: reproduces the data set", _YAML),
        _file(folder.identity, "identity", "hash of the recipe, backend and versions", _JSON),
    ]
    if sampler.recipe.layout == "shards":
        return [*files, _set("shards", "shards/*.tar", "shards: tar files of many samples", _TAR)]
    return [
        *files,
        _set("recordings", f"samples/*/*/{RECORDING}", "images of all cameras and frames, zarr in zip files", _ZIP),
        _set("truths", f"samples/*/*/{TRUTH}", "exact depth, disparity, flow and motion, zarr in zip files", _ZIP),
        _set("scenes", f"samples/*/*/{SCENE}", "scenes that reproduce single samples", _YAML),
        _set("rows", f"samples/*/*/{SAMPLE}", "catalogue entry of each sample", _JSON),
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

    # Croissant records cannot contain a list of structures: the column of objects is in the Parquet file only.
    values = [entry for entry in table.schema if not pa.types.is_nested(entry.type) or _is_plain_list(entry.type)]
    fields = [_field(entry, sampler) for entry in values]
    return {
        "@type": "cr:RecordSet",
        "@id": CATALOGUE,
        "name": CATALOGUE,
        "description": _is_described_elsewhere(table, values),
        "key": {"@id": f"{CATALOGUE}/sample"},
        "field": fields,
    }


def _is_plain_list(kind: pyarrow.DataType) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_list(kind) and not pa.types.is_nested(kind.value_type))


def _is_described_elsewhere(table: pyarrow.Table, described: list[pyarrow.Field]) -> str:
    left_out = [name for name in table.schema.names if name not in {entry.name for entry in described}]
    more = f" The file also has columns of lists of structures: {', '.join(left_out)}." if left_out else ""
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
        "dataType": _get_croissant_type(kind),
        "source": {"fileObject": {"@id": "catalogue.parquet"}, "extract": {"column": entry.name}},
    }
    return found | ({"isArray": True, "arrayShape": "-1"} if listed else {})


def _get_croissant_type(kind: pyarrow.DataType) -> str:
    import pyarrow as pa

    if pa.types.is_floating(kind):
        return "cr:Float64"
    if pa.types.is_integer(kind):
        return "cr:Int64"
    return "sc:Boolean" if pa.types.is_boolean(kind) else "sc:Text"

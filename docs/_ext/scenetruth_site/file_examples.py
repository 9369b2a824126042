"""Examples of models and their fields, from the bundled files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from scenetruth_site.file_models import Schema, inner_nodes, name_of, resolved

__all__ = ["FileExamples", "examples_in"]


@dataclass
class FileExamples:
    """Example values of models and fields.

    Parameters
    ----------
    of_models
        The name of a model to (file, its value there).
    of_fields
        The names of a model and a field to (file, its value there).
    """

    of_models: dict[str, tuple[str, Any]] = field(default_factory=dict)
    of_fields: dict[tuple[str, str], tuple[str, Any]] = field(default_factory=dict)


def examples_in(files: Iterable[Path], schema: Schema) -> FileExamples:
    """Return the first value of every model and field in the given files.

    Parameters
    ----------
    files
        Valid YAML files, each with one or more documents. For files in a folder ``examples`` no file name is
        given.
    schema
        The JSON Schema that they follow.
    """
    found = FileExamples()
    for file in files:
        name = "" if file.parent.name == "examples" else file.name
        for document in yaml.safe_load_all(file.read_text(encoding="utf-8")):
            _look(schema, schema, document, name, found)
    return found


def _look(schema: Schema, node: Schema, value: Any, file: str, found: FileExamples) -> None:
    """Record a value and all values in it whose schema can be determined."""
    node = resolved(schema, node)
    if "properties" in node:
        if not isinstance(value, Mapping):
            return
        found.of_models.setdefault(name_of(node), (file, value))
        for name, inner in node["properties"].items():
            if name in value:
                found.of_fields.setdefault((name_of(node), name), (file, value[name]))
                _look(schema, inner, value[name], file, found)
        return
    for more, inner in inner_nodes(node):
        if more == "" and _fits(schema, inner, value):
            _look(schema, inner, value, file, found)
        elif more == "[]" and isinstance(value, list):
            for one in value:
                _look(schema, inner, one, file, found)
        elif more.startswith(".") and isinstance(value, Mapping):
            for one in value.values():
                _look(schema, inner, one, file, found)


def _fits(schema: Schema, node: Schema, value: Any) -> bool:
    """Return whether a value matches one of several schemas by its keys and its ``kind``."""
    node = resolved(schema, node)
    if "properties" not in node:
        return node.get("type") in (None, "array", "object")
    if not isinstance(value, Mapping):
        return False
    named = all(value.get(key) == inner["const"] for key, inner in node["properties"].items() if _names(key, inner))
    return named and set(node.get("required", ())) <= set(value) <= set(node["properties"])


def _names(key: str, node: Schema) -> bool:
    return key in ("kind", "method") and "const" in node

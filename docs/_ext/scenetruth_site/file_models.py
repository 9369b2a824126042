"""The models of a file, from their JSON Schema: every model with its fields and paths."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = [
    "FileModel",
    "ModelField",
    "Schema",
    "anchor_of",
    "inner_nodes",
    "kind_of",
    "models_of",
    "name_of",
    "required_in",
    "resolved",
]

Schema = Mapping[str, Any]
"""JSON Schema, or a part of it, as plain values."""

_SECTION = re.compile(r"\n\n[A-Z][A-Za-z ]+\n-{3,}\n")


@dataclass(frozen=True)
class ModelField:
    """A field of a model.

    Parameters
    ----------
    name
        Its key in the file.
    node
        Its JSON Schema.
    required
        Whether it must be given.
    unless
        Fields that replace it: it is required only if none of them is given.
    """

    name: str
    node: Schema
    required: bool
    unless: tuple[str, ...] = ()


@dataclass
class FileModel:
    """A model: a mapping in a file.

    Parameters
    ----------
    name
        The name of its class.
    selector
        The key and value that distinguish it from its alternatives, ``("kind", "box")``; None without alternatives.
    description
        What it is.
    fields
        Its fields, in order.
    paths
        Its paths: ``camera``, ``objects[].mesh``; empty for the file itself.
    """

    name: str
    selector: tuple[str, str] | None
    description: str
    fields: tuple[ModelField, ...]
    paths: list[str] = field(default_factory=list)


def anchor_of(file: str, model: str, name: str = "") -> str:
    """Return the anchor of a model, or of a field of it, on the pages of a file type.

    Examples
    --------
    >>> anchor_of("scene", "BoxMesh"), anchor_of("scene", "BoxMesh", "size_mm")
    ('scene-boxmesh', 'scene-boxmesh-size-mm')
    """
    return "-".join(part for part in (file, model, name) if part).replace("_", "-").lower()


def inner_nodes(node: Schema) -> Iterator[tuple[str, Schema]]:
    """Yield the inner schemas of a field, each with the continuation of its path."""
    for key in ("oneOf", "anyOf", "allOf"):
        for inner in node.get(key, ()):
            yield "", inner
    for inner in node.get("prefixItems", ()):
        yield "[]", inner
    if isinstance(node.get("items"), Mapping):
        yield "[]", node["items"]
    if isinstance(node.get("additionalProperties"), Mapping):
        yield ".NAME", node["additionalProperties"]
    for inner in node.get("patternProperties", {}).values():
        yield ".PATH", inner


def models_of(schema: Schema) -> dict[str, FileModel]:
    """Return every model of a file by its name, in the order of their first use.

    Parameters
    ----------
    schema
        The JSON Schema of the file, as returned by ``model_json_schema()``.
    """
    found: dict[str, FileModel] = {}
    waiting: list[tuple[str, Schema]] = [("", schema)]
    while waiting:
        path, node = waiting.pop(0)
        node = resolved(schema, node)
        if "properties" not in node:
            waiting += [(path + more, inner) for more, inner in inner_nodes(node)]
            continue
        name = name_of(node)
        if name in found:
            if path not in found[name].paths:
                found[name].paths.append(path)
            continue
        fields = tuple(ModelField(key, inner, *required_in(node, key)) for key, inner in node["properties"].items())
        # The meaning of the model only; examples and cross references are for readers of the code.
        description = _SECTION.split(node.get("description", ""), maxsplit=1)[0]
        found[name] = FileModel(name, kind_of(node), description, fields, [path])
        waiting += [(f"{path}.{one.name}".lstrip("."), one.node) for one in fields]
    return found


def required_in(node: Schema, key: str) -> tuple[bool, tuple[str, ...]]:
    """Return whether a field is required, and the fields that replace it.

    Examples
    --------
    >>> either = {"anyOf": [{"required": ["positions", "baseline_mm"]}, {"required": ["positions_mm"]}]}
    >>> required_in(either, "baseline_mm")
    (True, ('positions_mm',))
    >>> required_in({"required": ["width"]}, "width"), required_in({}, "width")
    ((True, ()), (False, ()))
    """
    if key in node.get("required", ()):
        return True, ()
    spellings = [set(one["required"]) for one in node.get("anyOf", ()) if "required" in one]
    of_key = [spelling for spelling in spellings if key in spelling]
    # A field with a default, such as a preset, is optional.
    if not of_key or "default" in node.get("properties", {}).get(key, {}):
        return False, ()
    without = [spelling for spelling in spellings if key not in spelling]
    return True, tuple(sorted(set().union(*without) - set().union(*of_key)))


def resolved(schema: Schema, node: Schema) -> Schema:
    """Return the schema that a reference points to, or the schema itself."""
    if "$ref" in node:
        found: Schema = schema["$defs"][node["$ref"].rsplit("/", 1)[1]]
        return found
    return node


def name_of(node: Schema) -> str:
    """Return the name of a model from its JSON Schema; settings have the name of their method."""
    key, value = kind_of(node) or ("", "")
    title: str = node["title"]
    return value if key == "method" else title


def kind_of(node: Schema) -> tuple[str, str] | None:
    """Return the key and value that distinguish a model from its alternatives, ``("kind", "box")``."""
    for key in ("kind", "method"):
        value = node.get("properties", {}).get(key, {}).get("const")
        if isinstance(value, str):
            return key, value
    return None

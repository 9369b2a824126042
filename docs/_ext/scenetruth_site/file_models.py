"""What a file may say, read off the JSON Schema of its models: every model with its fields, and where it stands."""

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
        The fields of which one makes it needless, where it must be given without them.
    """

    name: str
    node: Schema
    required: bool
    unless: tuple[str, ...] = ()


@dataclass
class FileModel:
    """A model: a mapping that a file may hold.

    Parameters
    ----------
    name
        The name of its class.
    kind
        What tells it from the others that may stand in its place, ``("kind", "box")``; None if nothing does.
    description
        What it is.
    fields
        Its fields, in their order.
    paths
        Where it may stand: ``camera``, ``objects[].mesh``; empty for the file itself.
    """

    name: str
    kind: tuple[str, str] | None
    description: str
    fields: tuple[ModelField, ...]
    paths: list[str] = field(default_factory=list)


def anchor_of(file: str, model: str, name: str = "") -> str:
    """Return the anchor of a model, or of a field of it, on the pages of one sort of file.

    Examples
    --------
    >>> anchor_of("scene", "BoxMesh"), anchor_of("scene", "BoxMesh", "size_mm")
    ('scene-boxmesh', 'scene-boxmesh-size-mm')
    """
    return "-".join(part for part in (file, model, name) if part).replace("_", "-").lower()


def inner_nodes(node: Schema) -> Iterator[tuple[str, Schema]]:
    """Yield the schemas that a value of a field may have inside, each with what its path goes on with."""
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
    """Return every model of a file by its name, in the order in which a reader comes upon them.

    Parameters
    ----------
    schema
        The JSON Schema of the file, as ``model_json_schema()`` gives it.
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
        # What a model means; its examples and cross references are for whoever reads the code.
        description = _SECTION.split(node.get("description", ""), maxsplit=1)[0]
        found[name] = FileModel(name, kind_of(node), description, fields, [path])
        waiting += [(f"{path}.{one.name}".lstrip("."), one.node) for one in fields]
    return found


def required_in(node: Schema, key: str) -> tuple[bool, tuple[str, ...]]:
    """Return whether a field must be given, and the fields of which one makes it needless.

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
    # What has a default is short for the rest, as a preset is: it may be given.
    if not of_key or "default" in node.get("properties", {}).get(key, {}):
        return False, ()
    without = [spelling for spelling in spellings if key not in spelling]
    return True, tuple(sorted(set().union(*without) - set().union(*of_key)))


def resolved(schema: Schema, node: Schema) -> Schema:
    """Return the schema that another one refers to, or itself if it does not."""
    if "$ref" in node:
        found: Schema = schema["$defs"][node["$ref"].rsplit("/", 1)[1]]
        return found
    return node


def name_of(node: Schema) -> str:
    """Return what a model is called, from its JSON Schema: settings of methods after their method."""
    key, value = kind_of(node) or ("", "")
    title: str = node["title"]
    return value if key == "method" else title


def kind_of(node: Schema) -> tuple[str, str] | None:
    """Return what tells a model from those that may stand in its place, ``("kind", "box")``, from its JSON Schema."""
    for key in ("kind", "method"):
        value = node.get("properties", {}).get(key, {}).get("const")
        if isinstance(value, str):
            return key, value
    return None

"""Descriptions of types and ranges of fields, from their JSON Schema."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from scenetruth_site.file_models import Schema, anchor_of, inner_nodes, kind_of, name_of, resolved

__all__ = ["default_of", "range_of", "type_of", "yaml_of"]

_PLAIN = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false", "null": "null"}
_PLURAL = {"text": "texts", "number": "numbers", "whole number": "whole numbers"}
_BEYOND = 1e12
"""Limits beyond this value apply to every number of a file and are not printed."""


def type_of(node: Schema, file: str, schema: Schema) -> str:
    """Return the type of a field in words, as Markdown, with links to its models.

    Parameters
    ----------
    node
        The JSON Schema of the field.
    file
        The file type, used as the prefix of anchors.
    schema
        The JSON Schema of the whole file.

    Examples
    --------
    >>> type_of({"type": "array", "prefixItems": [{"type": "number"}] * 2}, "scene", {})
    '2 numbers'
    >>> box = {"title": "BoxMesh", "properties": {"kind": {"const": "box"}}}
    >>> node = {"anyOf": [{"$ref": "#/$defs/BoxMesh"}, {"const": "auto"}, {"type": "null"}]}
    >>> type_of(node, "scene", {"$defs": {"BoxMesh": box}})
    '[`box`](#scene-boxmesh) or `auto`'
    """
    node = resolved(schema, node)
    if "properties" in node:
        name, (_, value) = name_of(node), kind_of(node) or ("", "")
        return f"[{f'`{value}`' if value else name}](#{anchor_of(file, name)})"
    if "const" in node:
        return f"`{node['const']}`"
    if "enum" in node:
        return _either([f"`{word}`" for word in node["enum"]])
    for key in ("oneOf", "anyOf", "allOf"):
        if key in node:
            parts = [type_of(inner, file, schema) for inner in node[key] if inner.get("type") != "null"]
            return _either(list(dict.fromkeys(parts)))
    if node.get("type") == "array":
        return _array(node, file, schema)
    if node.get("type") == "object":
        inside = [type_of(inner, file, schema) for _, inner in inner_nodes(node) if inner]
        return f"mapping of names to {inside[0]}" if inside and inside[0] else "mapping"
    return _PLAIN.get(str(node.get("type")), "any value")


def _either(parts: list[str]) -> str:
    return " or ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _array(node: Schema, file: str, schema: Schema) -> str:
    if "prefixItems" in node:
        types = list(dict.fromkeys(type_of(inner, file, schema) for inner in node["prefixItems"]))
        if len(types) == 1:
            return f"{len(node['prefixItems'])} {_PLURAL.get(types[0], f'times {types[0]}')}"
        return f"[{', '.join(types)}]"
    inner = type_of(node.get("items", {}), file, schema)
    if node.get("minItems") is not None and node.get("minItems") == node.get("maxItems"):
        return f"{node['minItems']} {_PLURAL.get(inner, f'times {inner}')}"
    return f"list of {_PLURAL.get(inner, inner)}"


def range_of(node: Schema) -> str:
    """Return the range of the numbers of a field, or of its number of items; empty if unlimited.

    Examples
    --------
    >>> range_of({"type": "number", "exclusiveMinimum": 0, "maximum": 1e12}), range_of({"minimum": 0, "maximum": 1})
    ('> 0', '0 to 1')
    """
    return "; ".join(dict.fromkeys(_ranges(node, "")))


def _ranges(node: Schema, each: str) -> Iterator[str]:
    low, high = node.get("minimum"), node.get("maximum")
    above, below = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
    if low is not None and high is not None and abs(low) < _BEYOND and abs(high) < _BEYOND:
        yield f"{each}{low:.6g} to {high:.6g}"
    else:
        bounds = [("≥", low), (">", above), ("≤", high), ("<", below)]
        limits = [f"{sign} {bound:.6g}" for sign, bound in bounds if bound is not None and abs(bound) < _BEYOND]
        if limits:
            yield each + " and ".join(limits)
    least, most = node.get("minItems"), node.get("maxItems")
    if least != most:
        yield " and ".join(
            [f"at least {least} items" for _ in [0] if least] + [f"at most {most} items" for _ in [0] if most]
        )
    for more, inner in inner_nodes(node):
        yield from _ranges(inner, "each " if more == "[]" else each)


def default_of(node: Schema) -> str:
    """Return the default of an optional field, as Markdown."""
    if "default" not in node:
        # The schema has no default for values that are created by a factory.
        return "empty" if node.get("type") in ("object", "array") else "that of each of its fields"
    value = node["default"]
    if value is None:
        return "not given"
    text = yaml_of(value)
    return "that of each of its fields" if isinstance(value, dict) and value else f"`{text}`"


def yaml_of(value: object) -> str:
    """Return a value as YAML on one line.

    Examples
    --------
    >>> yaml_of([1, 2.0]), yaml_of(""), yaml_of({"kind": "box"})
    ('[1, 2.0]', "''", '{kind: box}')
    """
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n...\n").strip()

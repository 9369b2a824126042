"""Types and ranges of fields in words, from their JSON Schema."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from scenetruth_site.file_models import Schema, anchor_of, inner_nodes, kind_of, name_of, resolved

__all__ = ["default_of", "range_of", "type_of", "yaml_of"]

_PLAIN = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false", "null": "null"}
_PLURAL = {"text": "texts", "number": "numbers", "whole number": "whole numbers"}
_BEYOND = 1e12
"""No number of a file is larger than this, whatever it is: not worth a word."""


def type_of(node: Schema, file: str, schema: Schema) -> str:
    """Return the type of a field's value in words, as Markdown, with links to the models that it may be.

    Parameters
    ----------
    node
        The field's JSON Schema.
    file
        The sort of file, which anchors begin with.
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
        name, (_, kind) = name_of(node), kind_of(node) or ("", "")
        return f"[{f'`{kind}`' if kind else name}](#{anchor_of(file, name)})"
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
        kinds = list(dict.fromkeys(type_of(inner, file, schema) for inner in node["prefixItems"]))
        if len(kinds) == 1:
            return f"{len(node['prefixItems'])} {_PLURAL.get(kinds[0], f'times {kinds[0]}')}"
        return f"[{', '.join(kinds)}]"
    inner = type_of(node.get("items", {}), file, schema)
    if node.get("minItems") is not None and node.get("minItems") == node.get("maxItems"):
        return f"{node['minItems']} {_PLURAL.get(inner, f'times {inner}')}"
    return f"list of {_PLURAL.get(inner, inner)}"


def range_of(node: Schema) -> str:
    """Return what numbers of a field may be, or how many of its items or letters there may be; empty if all may.

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
        told = [f"{sign} {bound:.6g}" for sign, bound in bounds if bound is not None and abs(bound) < _BEYOND]
        if told:
            yield each + " and ".join(told)
    least, most = node.get("minItems"), node.get("maxItems")
    if least != most:
        yield " and ".join(
            [f"at least {least} items" for _ in [0] if least] + [f"at most {most} items" for _ in [0] if most]
        )
    for more, inner in inner_nodes(node):
        yield from _ranges(inner, "each " if more == "[]" else each)


def default_of(node: Schema) -> str:
    """Return the default of a field that need not be given, as Markdown."""
    if "default" not in node:
        # Made anew for every file: of these, the schema does not tell.
        return "empty" if node.get("type") in ("object", "array") else "that of each of its fields"
    value = node["default"]
    if value is None:
        return "not given"
    text = yaml_of(value)
    return "that of each of its fields" if isinstance(value, dict) and value else f"`{text}`"


def yaml_of(value: object) -> str:
    """Return a value as it stands in a file, on one line.

    Examples
    --------
    >>> yaml_of([1, 2.0]), yaml_of(""), yaml_of({"kind": "box"})
    ('[1, 2.0]', "''", '{kind: box}')
    """
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n...\n").strip()

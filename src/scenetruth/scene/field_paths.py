"""Field paths in scenes, recipes and design specifications: wildcards, values, assignment."""

from __future__ import annotations

import difflib
import json
from collections.abc import Collection, Iterable, Iterator
from typing import Any

from scenetruth.errors import EstimateError
from scenetruth.estimators import DEFAULT_METHOD, choose, find_method

__all__ = ["METHOD", "PathError", "assign", "drop_settings", "expand", "order_paths", "value_at"]

METHOD = "estimate.method"

_ANY = "*"
_MAX_SUGGESTED = 3


class PathError(Exception):
    """Invalid path, with the reason as message."""


def expand(plain: Any, path: str) -> list[str]:
    """Return the paths matched by a path with wildcards; a path without wildcards is returned unchanged.

    ``path``: Keys and indices separated by dots; ``*`` matches every existing key or index. The last key need not
      exist; the validation of the result reports unknown keys.

    >>> expand({"objects": [{"name": "a"}, {"name": "b"}]}, "objects.*.name")
    ['objects.0.name', 'objects.1.name']
    """
    found = list(_expanded(plain, path.split("."), []))
    if not found:
        msg = f"matches nothing: '{path.partition('.*')[0]}' is empty"
        raise PathError(msg)
    return found


def _expanded(here: Any, keys: list[str], above: list[str]) -> Iterator[str]:
    if not keys:
        yield ".".join(above)
        return
    first, *rest = keys
    if first == _ANY and isinstance(here, dict | list):
        for key in here if isinstance(here, dict) else range(len(here)):
            yield from _expanded(here[key], rest, [*above, str(key)])
        return
    if not rest and isinstance(here, dict):
        # The validation of the result checks whether the key is allowed.
        yield ".".join([*above, first])
        return
    yield from _expanded(_below(here, first, above), rest, [*above, first])


def value_at(plain: Any, path: str) -> Any:
    """Return the value at a path without wildcards."""
    here, above = plain, list[str]()
    for key in path.split("."):
        here = _below(here, key, above)
        above.append(key)
    return here


def assign(plain: Any, path: str, value: Any) -> None:
    """Set the value at a path without wildcards, in place.

    If the method of a scene changes, the settings of the former method are dropped: see `order_paths`.
    """
    if path == METHOD and isinstance(plain, dict):
        drop_settings(plain, value)
    *around, last = path.split(".")
    here, above = plain, list[str]()
    for key in around:
        here = _below(here, key, above)
        above.append(key)
    if isinstance(here, dict):
        here[last] = value
    elif isinstance(here, list):
        _below(here, last, above)
        here[int(last)] = value
    else:
        raise PathError(_no_fields(here, last, above))


def order_paths(paths: Iterable[str]) -> list[str]:
    """Return paths in the order in which they are to be assigned: the method before its settings.

    >>> order_paths(["estimate.tau", "camera.width", "estimate.method"])
    ['estimate.method', 'estimate.tau', 'camera.width']
    """
    return sorted(paths, key=lambda path: path != METHOD)


def drop_settings(plain: dict[str, Any], method: Any, kept: Collection[str] = ()) -> list[str]:
    """Drop the settings of the scene's method, in place, if ``method`` is another; return those without their default.

    ``kept``: Settings of the new method, which stay.
    """
    section = plain.get("estimate")
    if not isinstance(section, dict) or not isinstance(method, str):
        return []
    former = section.get("method", DEFAULT_METHOD)
    dropped = {key: value for key, value in section.items() if key != "method" and key not in kept}
    if method == former or not dropped:
        return []
    try:
        find_method(method)
        defaults = choose({"method": former}).model_dump(mode="json")
    except EstimateError:
        return []  # the validation of the scene reports the method
    for key in dropped:
        del section[key]
    return [key for key, value in dropped.items() if key not in defaults or defaults[key] != value]


def _below(here: Any, key: str, above: list[str]) -> Any:
    if isinstance(here, dict):
        if key in here:
            return here[key]
        near = difflib.get_close_matches(key, [str(one) for one in here], n=_MAX_SUGGESTED)
        text = " or ".join(f"'{'.'.join([*above, one])}'" for one in near)
        msg = f"there is no '{'.'.join([*above, key])}'" + (f"; did you mean {text}?" if text else "")
        raise PathError(msg)
    if isinstance(here, list):
        if key.isascii() and key.isdigit() and int(key) < len(here):
            return here[int(key)]
        msg = f"'{'.'.join(above)}' is a list of {len(here)}; '{key}' is not an index of it"
        raise PathError(msg)
    raise PathError(_no_fields(here, key, above))


def _no_fields(here: Any, key: str, above: list[str]) -> str:
    """Return a message for a value that is not a mapping, with a remedy."""
    path = ".".join(above)
    is_number = isinstance(here, int | float)
    remedy = f"end the path at '{path}'"
    if not is_number:
        # A null value, or a word such as `sensor: ideal`, may be replaced by a mapping.
        whole = f"set all of '{path}' to a mapping first, under 'set'"
        remedy = whole if here is None else f"{whole}, or {remedy}"
    return f"'{path}' is {json.dumps(here):.60} in the scene, and has no field '{key}': {remedy}"

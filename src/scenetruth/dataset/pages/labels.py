"""Paths of fields as people read them: words, the names of objects, and units from the names of fields."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from scenetruth.dataset.recipe.paths import PathError, value_at

__all__ = ["bracketed", "label_of", "split_unit"]

_UNITS = {
    "_mm_per_frame2": "mm per frame²",
    "_mm_per_frame": "mm per frame",
    "_px_per_frame": "px per frame",
    "_deg_per_frame": "° per frame",
    "_rate_per_hour": "1 per hour",
    "_per_hour": "1 per hour",
    "_per_frame": "per frame",
    "_per_mm2": "1 per mm²",
    "_per_mm": "1 per mm",
    "_per_px": "1 per px",
    "_frames": "frames",
    "_share": "share",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_px": "px",
    "_deg": "°",
    "_ms": "ms",
    "_us": "µs",
    "_s": "s",
}
"""Ends of names that tell a unit, the longer first."""
_AXES = ("X", "Y", "Z")
_UNTOLD = ("lighting",)
"""Parts of a scene whose parts tell enough."""
_UNIT_VECTORS = ([1, 0, 0], [0, 1, 0], [0, 0, 1])


def split_unit(name: str) -> tuple[str, str]:
    """Return a name in words, and the unit that it ends with; an empty text for none.

    Examples
    --------
    >>> split_unit("focal_length_px"), split_unit("rate_per_hour"), split_unit("seen_share"), split_unit("seed")
    (('focal length', 'px'), ('rate', '1 per hour'), ('seen share', ''), ('seed', ''))
    """
    for end, unit in _UNITS.items():
        if name.endswith(end) and len(name) > len(end):
            kept = name.removesuffix(end) if unit != "share" else name
            kept += "_rate" if end == "_rate_per_hour" else ""
            return kept.replace("_", " "), "" if unit == "share" else unit
    if name == "rate_per_hour":
        return "rate", "1 per hour"
    return name.replace("_", " "), ""


def label_of(path: str, plain: Mapping[str, Any]) -> tuple[str, str]:
    """Return a field in words, and its unit.

    Parameters
    ----------
    path
        Its path in a scene, or the name of a value.
    plain
        A scene with that field, as plain values: objects are told by their names, parts by their kinds.

    Examples
    --------
    >>> scene = {"objects": [{"name": "cube", "pose": {"position_mm": [0, 0, 600]}, "motion": [{"kind": "velocity"}]}]}
    >>> label_of("objects.0.pose.position_mm.2", scene), label_of("objects.0.motion.0.velocity_mm_per_frame", scene)
    (('cube: pose position Z', 'mm'), ('cube: motion velocity', 'mm per frame'))
    """
    words: list[str] = []
    unit, above = "", list[str]()
    for key in path.split("."):
        if re.fullmatch(r"[0-9]+", key) and above:
            words = _with_index(words, int(key), _at(plain, above))
        else:
            told, own = split_unit(key)
            unit = f"{unit} {own}" if unit and own.startswith("per ") else own
            # A velocity's velocity need not be told twice.
            words += [] if key in _UNTOLD or (words and told == words[-1]) else [told]
        above.append(key)
    return " ".join(words), unit


def bracketed(title: str, unit: str) -> str:
    """Return a title with its unit in brackets, if it has one."""
    return f"{title} [{unit}]" if unit else title


def _with_index(words: list[str], index: int, around: Any) -> list[str]:
    """Add an entry of a list to words: by its name, its kind, its axis, or its number."""
    if isinstance(around, Sequence) and not isinstance(around, str) and index < len(around):
        entry = around[index]
        if isinstance(entry, Mapping) and isinstance(entry.get("name"), str):
            return [*words[:-1], f"{entry['name']}:"]
        if isinstance(entry, Mapping) and isinstance(entry.get("kind"), str):
            return [*words, entry["kind"].replace("_", " ")]
        if isinstance(entry, Mapping) and entry.get("axis") in _UNIT_VECTORS:
            return [*words, f"about {_AXES[_UNIT_VECTORS.index(entry['axis'])]}"]
        if len(around) == len(_AXES) and all(isinstance(one, int | float) for one in around):
            return [*words, _AXES[index]]
    return [*words, f"({index})"]


def _at(plain: Mapping[str, Any], keys: Sequence[str]) -> Any:
    try:
        return value_at(plain, ".".join(keys))
    except PathError:
        return None

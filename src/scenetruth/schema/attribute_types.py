"""Whether the attributes of a data set are of the types that their readers take for granted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import Problem
from scenetruth.plain import parse_json, plain_problems

__all__ = ["attribute_problems", "is_finite_number"]

_MAPPINGS_IN_JSON = ("scene", "versions", "settings")
_TEXTS = ("scene_hash", "recording_hash", "estimate_hash", "method", "render_backend", "truth_poses")


def attribute_problems(dataset: xr.Dataset) -> list[Problem]:
    """Return which attributes are not what they should be; those that are missing are not looked for."""
    attrs = dataset.attrs
    problems = [
        Problem(f"attrs.{name}", "must be a text", attrs[name])
        for name in _TEXTS
        if name in attrs and not isinstance(attrs[name], str)
    ]
    for name in _MAPPINGS_IN_JSON:
        if name in attrs:
            problems += _json_problems(f"attrs.{name}", attrs[name], dict)
    if "object_names" in attrs:
        problems += _json_problems("attrs.object_names", attrs["object_names"], list)
    reason, seed = attrs.get("render_fallback_reason"), attrs.get("seed")
    if not (reason is None or isinstance(reason, str)):
        problems.append(Problem("attrs.render_fallback_reason", "must be a text", reason))
    if not (seed is None or (isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0)):
        problems.append(Problem("attrs.seed", "must be an integer that is not negative", seed))
    distortion = attrs.get("distortion")
    listed = isinstance(distortion, list | tuple | np.ndarray) and getattr(distortion, "ndim", 1) == 1
    if distortion is not None and not (listed and all(map(is_finite_number, distortion))):
        problems.append(Problem("attrs.distortion", "must be a list of finite numbers", distortion))
    return problems


def is_finite_number(value: Any) -> bool:
    """Tell whether a value is a real number, neither infinite nor too large for a float."""
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool):
        return False
    try:
        return bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def _json_problems(path: str, text: Any, kind: type[Any]) -> list[Problem]:
    named = "a mapping" if kind is dict else "a list of texts"
    if not isinstance(text, str):
        return [Problem(path, f"must be {named} in JSON", "None" if text is None else text)]
    try:
        content = parse_json(text)
    except ValueError as error:
        return [Problem(path, f"must be {named} in JSON, and cannot be read: {error}", text)]
    if not isinstance(content, kind):
        return [Problem(path, f"must be {named} in JSON", text)]
    if kind is list and not all(isinstance(item, str) for item in content):
        return [Problem(path, f"must be {named} in JSON", text)]
    problems = [Problem(f"{path}.{item.path}", item.message, item.value) for item in plain_problems(content)]
    if path.endswith(".scene"):
        problems += [
            Problem(f"{path}.{name}", f"must be a {'mapping' if wanted is Mapping else 'text'}", content[name])
            for name, wanted in (("estimate", Mapping), ("score", Mapping), ("description", str))
            if content.get(name) is not None and not isinstance(content[name], wanted)
        ]
    return problems

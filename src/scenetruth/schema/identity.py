"""Which run a data set belongs to: hashes that travel from the recording to all that is made from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import MismatchError, Problem

__all__ = ["check_same_run", "digest", "estimate_hash", "identity_of"]

_HASHES = ("recording_hash", "scene_hash")


def digest(value: Any) -> str:
    """Return a hash of plain values, the same on every machine: 16 hexadecimal digits.

    Examples
    --------
    >>> digest({"b": 1, "a": [2, None]}) == digest({"a": [2, None], "b": 1})
    True
    """
    text = json.dumps(value, sort_keys=True, ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def estimate_hash(estimate: xr.Dataset) -> str:
    """Return a hash of what an estimate depends on: its recording, the method and the method's settings.

    An estimate without settings was computed elsewhere: what its maps hold counts instead.
    """
    attrs = estimate.attrs
    if "settings" in attrs:
        return digest([attrs.get("recording_hash"), attrs.get("method"), json.loads(attrs["settings"])])
    found = hashlib.sha256()
    for name, item in sorted(estimate.data_vars.items()):
        found.update(str(name).encode() + np.ascontiguousarray(item.values).tobytes())
    return digest([attrs.get("recording_hash"), attrs.get("method"), found.hexdigest()])


def identity_of(dataset: xr.Dataset) -> dict[str, str]:
    """Return the hashes that a data set carries: ``recording_hash``, ``scene_hash``, of an estimate its own too.

    ``scene_hash`` stands for everything in the scene that images and truth depend on, ``recording_hash`` for that and
    for the backend that rendered. Data from elsewhere has none.
    """
    return {name: str(dataset.attrs[name]) for name in (*_HASHES, "estimate_hash") if name in dataset.attrs}


def check_same_run(parts: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse parts of different runs.

    Parameters
    ----------
    parts
        Attributes of the parts by name, such as the path of the store: of data sets, or the metadata of a score. Parts
        that do not tell where they are from are taken as they are.

    Raises
    ------
    MismatchError
        With every part that was made from another recording than the first, by both names.
    """
    problems = []
    names = list(parts)
    for name in names[1:]:
        for key in _HASHES:
            one, other = parts[names[0]].get(key), parts[name].get(key)
            if one is not None and other is not None and one != other:
                what = key.removesuffix("_hash")
                message = f"belongs to another {what} than {names[0]}: {other}, not {one}"
                problems.append(Problem(name, message))
                break
    if problems:
        raise MismatchError(problems)

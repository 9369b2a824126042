"""The attributes of a data set: intrinsics, scene, object names, and the hashes that say to which run it belongs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import MismatchError, Problem

__all__ = [
    "Intrinsics",
    "check_same_run",
    "digest",
    "estimate_hash",
    "read_intrinsics",
    "read_lineage",
    "read_object_names",
    "read_scene",
]


@dataclass(frozen=True)
class Intrinsics:
    """The numbers that lead from pixels to the world, as a data set's attributes carry them.

    ``focal_length_px``: f, in pixels.
    ``principal_point_px``: (c_x, c_y), in pixel indices.
    ``baseline_mm``: V_X, the camera's displacement per step of s.
    ``frame_interval_s``: Time between two frames.
    """

    focal_length_px: float
    principal_point_px: tuple[float, float]
    baseline_mm: float
    frame_interval_s: float = 1.0

    def to_attrs(self) -> dict[str, Any]:
        """Return the attributes that hold these numbers."""
        return {
            "focal_length_px": float(self.focal_length_px),
            "principal_point_px": [float(value) for value in self.principal_point_px],
            "baseline_mm": float(self.baseline_mm),
            "frame_interval_s": float(self.frame_interval_s),
        }


def read_intrinsics(dataset: xr.Dataset) -> Intrinsics:
    """Read the intrinsics from the attributes of a checked data set."""
    attrs = dataset.attrs
    c_x, c_y = attrs["principal_point_px"]
    return Intrinsics(
        focal_length_px=float(attrs["focal_length_px"]),
        principal_point_px=(float(c_x), float(c_y)),
        baseline_mm=float(attrs["baseline_mm"]),
        frame_interval_s=float(attrs["frame_interval_s"]),
    )


def read_scene(dataset: xr.Dataset) -> dict[str, Any] | None:
    """Return the scene that a data set was made from, as plain values, or None for data from elsewhere."""
    text = dataset.attrs.get("scene")
    return None if text is None else dict(json.loads(text))


def read_object_names(dataset: xr.Dataset) -> list[str]:
    """Return the names of the objects that ``object_id`` counts, from 0 on; empty for data from elsewhere.

    >>> read_object_names(xr.Dataset(attrs={"object_names": '["leaf", "soil"]'}))
    ['leaf', 'soil']
    """
    return [str(name) for name in json.loads(dataset.attrs.get("object_names", "[]"))]


_HASHES = ("recording_hash", "scene_hash")


def digest(value: Any) -> str:
    """Return a hash of plain values, the same on every machine: 16 hexadecimal digits.

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


def read_lineage(dataset: xr.Dataset) -> dict[str, str]:
    """Return the hashes that a data set carries: ``recording_hash``, ``scene_hash``, of an estimate its own too.

    ``scene_hash`` stands for everything in the scene that images and truth depend on, ``recording_hash`` for that and
    for the backend that rendered. Data from elsewhere has none.
    """
    return {name: str(dataset.attrs[name]) for name in (*_HASHES, "estimate_hash") if name in dataset.attrs}


def check_same_run(parts: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse parts of different runs."""
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

"""Attributes of a data set: intrinsics, scene, object names and identifying hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.errors import MismatchError, Problem
from scenetruth.lazy_exports import lazy_module

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = [
    "Intrinsics",
    "check_same_run",
    "digest",
    "estimate_hash",
    "flat_attributes",
    "read_intrinsics",
    "read_lineage",
    "read_object_names",
    "read_scene",
]


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics in pixels, baseline V_X in mm per step of s, and frame interval in s."""

    focal_length_px: float
    principal_point_px: tuple[float, float]
    baseline_mm: float
    frame_interval_s: float = 1.0

    def to_attrs(self) -> dict[str, Any]:
        """Return the intrinsics as data-set attributes."""
        return {
            "focal_length_px": float(self.focal_length_px),
            "principal_point_px": [float(value) for value in self.principal_point_px],
            "baseline_mm": float(self.baseline_mm),
            "frame_interval_s": float(self.frame_interval_s),
        }


def read_intrinsics(dataset: xr.Dataset) -> Intrinsics:
    """Read the intrinsics from the attributes of a validated data set."""
    attrs = dataset.attrs
    c_x, c_y = attrs["principal_point_px"]
    return Intrinsics(
        focal_length_px=float(attrs["focal_length_px"]),
        principal_point_px=(float(c_x), float(c_y)),
        baseline_mm=float(attrs["baseline_mm"]),
        frame_interval_s=float(attrs["frame_interval_s"]),
    )


def read_scene(dataset: xr.Dataset) -> dict[str, Any] | None:
    """Return the scene of a simulated data set as a dictionary, or None for other data."""
    text = dataset.attrs.get("scene")
    return None if text is None else dict(json.loads(text))


def read_object_names(dataset: xr.Dataset) -> list[str]:
    """Return the object names in the order of ``object_id``; empty for data that were not simulated.

    >>> read_object_names(xr.Dataset(attrs={"object_names": '["leaf", "soil"]'}))
    ['leaf', 'soil']
    """
    return [str(name) for name in json.loads(dataset.attrs.get("object_names", "[]"))]


def flat_attributes(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes that netCDF can hold: numbers, texts and lists of numbers; all others as JSON text.

    Empty lists become text as well, so that the type of an attribute does not depend on its length.

    >>> flat_attributes({"tau": 0.5, "iterations": [4, 7], "excluded_images": [[1, 2]], "counts": {"dead": 0}})
    {'tau': 0.5, 'iterations': [4, 7], 'excluded_images': '[[1, 2]]', 'counts': '{"dead": 0}'}
    """
    return {name: value if _is_flat(value) else json.dumps(value, default=_plain) for name, value in attrs.items()}


def _is_flat(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim <= 1 and value.size > 0 and value.dtype.kind in "biuf"
    if isinstance(value, list | tuple):
        return bool(value) and all(isinstance(item, _NUMBERS) for item in value)
    # Types that JSON does not have either are rejected where they are written.
    return value is not None and not isinstance(value, Mapping)


_NUMBERS = (bool, int, float, np.bool_, np.integer, np.floating)


def _plain(value: Any) -> Any:
    """Return the JSON equivalent of a value that the json module does not know."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


_HASHES = ("recording_hash", "scene_hash")


def digest(value: Any) -> str:
    """Return a platform-independent hash of JSON values: 16 hexadecimal digits.

    >>> digest({"b": 1, "a": [2, None]}) == digest({"a": [2, None], "b": 1})
    True
    """
    text = json.dumps(value, sort_keys=True, ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def estimate_hash(estimate: xr.Dataset) -> str:
    """Return a hash of recording, method and settings of an estimate (without settings: of its values)."""
    attrs = estimate.attrs
    if "settings" in attrs:
        return digest([attrs.get("recording_hash"), attrs.get("method"), json.loads(attrs["settings"])])
    found = hashlib.sha256()
    for name, item in sorted(estimate.data_vars.items()):
        found.update(str(name).encode() + np.ascontiguousarray(item.values).tobytes())
    return digest([attrs.get("recording_hash"), attrs.get("method"), found.hexdigest()])


def read_lineage(dataset: xr.Dataset) -> dict[str, str]:
    """Return the hashes of a data set: ``recording_hash``, ``scene_hash`` and, for estimates, ``estimate_hash``.

    The scene hash covers all scene fields that affect images and ground truth; the recording hash also covers the
    rendering backend. Data that were not simulated have no hashes.
    """
    return {name: str(dataset.attrs[name]) for name in (*_HASHES, "estimate_hash") if name in dataset.attrs}


def check_same_run(parts: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise a MismatchError if the data sets belong to different recordings or scenes."""
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

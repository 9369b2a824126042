"""What the attributes of a data set say: intrinsics, the scene, the names of its objects."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import xarray as xr

__all__ = ["Intrinsics", "intrinsics_of", "object_names_of", "scene_of"]


@dataclass(frozen=True)
class Intrinsics:
    """The numbers that lead from pixels to the world, as a data set's attributes carry them.

    Parameters
    ----------
    focal_length_px
        f, in pixels.
    principal_point_px
        (c_x, c_y), in pixel indices.
    baseline_mm
        V_X, the camera's displacement per step of s.
    frame_interval_s
        Time between two frames.
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


def intrinsics_of(dataset: xr.Dataset) -> Intrinsics:
    """Read the intrinsics from the attributes of a checked data set."""
    attrs = dataset.attrs
    c_x, c_y = attrs["principal_point_px"]
    return Intrinsics(
        focal_length_px=float(attrs["focal_length_px"]),
        principal_point_px=(float(c_x), float(c_y)),
        baseline_mm=float(attrs["baseline_mm"]),
        frame_interval_s=float(attrs["frame_interval_s"]),
    )


def scene_of(dataset: xr.Dataset) -> dict[str, Any] | None:
    """Return the scene that a data set was made from, as plain values, or None for data from elsewhere."""
    text = dataset.attrs.get("scene")
    return None if text is None else dict(json.loads(text))


def object_names_of(dataset: xr.Dataset) -> list[str]:
    """Return the names of the objects that ``object_id`` counts, from 0 on; empty for data from elsewhere.

    Examples
    --------
    >>> object_names_of(xr.Dataset(attrs={"object_names": '["leaf", "soil"]'}))
    ['leaf', 'soil']
    """
    return [str(name) for name in json.loads(dataset.attrs.get("object_names", "[]"))]

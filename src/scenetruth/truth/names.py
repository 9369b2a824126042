"""The maps that a truth has, and the types of their values."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["DTYPES", "FOLLOWED", "FURTHER", "MOVED", "STANDARD"]

STANDARD = (
    "depth",
    "velocity",
    "disparity",
    "flow",
    "normal",
    "object_id",
    "face_id",
    "barycentric",
    "growth_rate",
    "mixed",
    "boundary_distance",
)
"""The maps of one image that every truth has."""

FURTHER = (
    "acceleration",
    "slope",
    "curvature",
    "rotation_rate",
    "growth_principal",
    "growth_direction",
    "uv",
    "surface_mm",
)
"""The maps of one image that a complete truth has besides."""

FOLLOWED = ("view_count", "occluded_in_s", "occluded_in_t")
"""The maps that take other images, and that every truth has."""

MOVED = ("displacement_next", "displacement_previous", "flow_next", "flow_previous")
"""The maps that take the frames before and after, and that a complete truth has."""

DTYPES: dict[str, type[np.generic[Any]]] = {
    "object_id": np.int32,
    "face_id": np.int32,
    "mixed": np.bool_,
    "view_count": np.int16,
    "occluded_in_s": np.bool_,
    "occluded_in_t": np.bool_,
}
"""Types of the values that are not float64."""

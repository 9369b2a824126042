"""Surface points of the reference camera's pixels, their positions in every image, and connected surface segments."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import Intrinsics

__all__ = [
    "ImagePosition",
    "ImageTimes",
    "ReferencePoints",
    "compute_image_times",
    "compute_interior_mask",
    "compute_reference_points",
    "label_surface_segments",
]


Map = NDArray[np.float64]


class ImagePosition(NamedTuple):
    """Image positions of points, in px from the principal point, and their scale relative to the reference image."""

    x: Map
    y: Map
    scale: Map


@dataclass(frozen=True, eq=False)
class ReferencePoints:
    """Surface points of the pixels at the reference time, and their motion; all arrays have the shape of the pixels.

    ``x``, ``y``, ``focal``: Pixel coordinates from the principal point, and focal length, in px.
    ``d``, ``d_x``, ``d_y``: Disparity in px per step, and its slopes along x and y.
    ``q``, ``q_x``, ``q_y``: Velocity in baselines per frame, and its slopes along x and y, shape (3, ...).
    """

    x: Map
    y: Map
    d: Map
    d_x: Map
    d_y: Map
    q: Map
    q_x: Map
    q_y: Map
    focal: float

    def at(self, where: tuple[slice | NDArray[np.int64], ...]) -> ReferencePoints:
        """Return the points at an index."""
        parts: dict[str, Any] = {
            item.name: getattr(self, item.name)[(..., *where)] for item in fields(self) if item.name != "focal"
        }
        return replace(self, **parts)

    def place(self, s: float | Map, s_y: float | Map, t: float | Map) -> ImagePosition:
        """Return the image positions of the points for a camera position and a time."""
        scale = 1.0 / (1.0 + self.d * (t * self.q[2]) / self.focal)
        x = (self.x + self.d * (t * self.q[0] - s)) * scale
        y = (self.y + self.d * (t * self.q[1] - s_y)) * scale
        return ImagePosition(x, y, scale)

    def tangents(self) -> tuple[Map, Map]:
        """Return the derivatives of the surface p = (x, y, f) / d along x and y, in baselines, each (3, ...)."""
        p = np.stack([self.x, self.y, np.full_like(self.x, self.focal)]) / self.d
        along, down = -p * self.d_x / self.d, -p * self.d_y / self.d
        along[0] += 1.0 / self.d
        down[1] += 1.0 / self.d
        return along, down


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Camera positions in baselines, times in frames, and indices (s_y, s, t) in the recording, of n images."""

    s: Map
    s_y: Map
    t: Map
    frame_of: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.s)

    def nearest(self, most: int) -> NDArray[np.int64]:
        """Return the indices of the images nearest to the reference, starting with the reference."""
        distance = np.abs(self.s) + np.abs(self.s_y) + np.abs(self.t)
        return np.argsort(distance, kind="stable")[:most]


def compute_image_times(recording: xr.Dataset, baseline_mm: float) -> ImageTimes:
    """Return the planned positions and times of the images of a recording."""
    along = np.asarray(recording["stage_x_mm"].values, dtype=np.float64) / baseline_mm
    rows = "s_y" in recording["image"].dims
    across = np.asarray(recording["stage_y_mm"].values, dtype=np.float64) / baseline_mm if rows else np.zeros(1)
    times = np.asarray(recording["t"].values, dtype=np.float64)
    index = np.stack(np.meshgrid(*(np.arange(len(part)) for part in (across, along, times)), indexing="ij"), axis=-1)
    numbers = index.reshape(-1, 3)
    return ImageTimes(along[numbers[:, 1]], across[numbers[:, 0]], times[numbers[:, 2]], numbers)


def compute_reference_points(truth: xr.Dataset, intrinsics: Intrinsics, pieces: NDArray[np.int64]) -> ReferencePoints:
    """Return the surface points of one camera and frame."""
    focal, (c_x, c_y) = intrinsics.focal_length_px, intrinsics.principal_point_px
    x, y = np.meshgrid(truth["x"].values - c_x, truth["y"].values - c_y)
    on = pieces >= 0
    depth = np.where(on, truth["depth"].values, np.nan)
    d = focal * intrinsics.baseline_mm / depth
    n_x, n_y, n_z = np.asarray(truth["normal"].values, dtype=np.float64)
    # On the plane N · P = c, d is proportional to N · (x, y, f).
    toward = n_x * x + n_y * y + n_z * focal
    q = np.asarray(truth["velocity"].values, dtype=np.float64) / intrinsics.baseline_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        d_x, d_y = d * n_x / toward, d * n_y / toward
    q_x, q_y = (_slope(q, pieces, axis) for axis in (-1, -2))
    d_x, d_y, q = (np.where(on & np.isfinite(part), part, 0.0) for part in (d_x, d_y, q))
    return ReferencePoints(x, y, np.where(on, d, 1.0), d_x, d_y, q, q_x, q_y, focal)


def _slope(values: Map, pieces: NDArray[np.int64], axis: int) -> Map:
    """Return the mean difference from the neighbours along an axis that belong to the same segment; 0 without any."""
    before, after = (
        (..., part) if axis == -1 else (..., part, slice(None)) for part in (slice(None, -1), slice(1, None))
    )
    same = (pieces[before] >= 0) & (pieces[before] == pieces[after])
    with np.errstate(invalid="ignore"):
        step = np.where(same, values[after] - values[before], 0.0)
    total, count = np.zeros_like(values), np.zeros(pieces.shape)
    for side in (before, after):
        total[side] += step
        count[side] += same
    return np.asarray(total / np.maximum(count, 1.0))


_REACH_PX = 2  # the spline derivative reaches further: a step at a distance of 3 px contributes a tenth of its height


def label_surface_segments(truth: xr.Dataset) -> NDArray[np.int64]:
    """Label connected surface segments of the reference image, bounded by mixed pixels and objects; -1 elsewhere."""
    from scipy.ndimage import label

    depth = truth["depth"].values
    seen = np.isfinite(depth) & (depth > 0) & ~truth["mixed"].values.astype(bool)
    objects = truth["object_id"].values if "object_id" in truth else np.zeros(depth.shape, dtype=np.int64)
    pieces = np.full(depth.shape, -1, dtype=np.int64)
    count = 0
    for number in np.unique(objects[seen]):
        labels, found = label(seen & (objects == number))
        pieces[labels > 0] = labels[labels > 0] + count - 1
        count += found
    return pieces


def compute_interior_mask(pieces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the pixels at least 2 px inside their segment, where image derivatives are those of the texture."""
    from scipy.ndimage import maximum_filter, minimum_filter

    size = 2 * _REACH_PX + 1
    same = maximum_filter(pieces, size, mode="nearest") == minimum_filter(pieces, size, mode="nearest")
    return np.asarray(same & (pieces >= 0))

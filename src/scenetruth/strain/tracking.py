"""Displacements of the points of a reference frame in all other frames, from the velocities of an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.scoring.error_pairs import find_valid_pixels
from scenetruth.strain.camera_rays import CameraRays

__all__ = ["TrackedDisplacements", "track_displacements"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MAX_SLOPE = math.tan(math.radians(80.0))


@dataclass(frozen=True, eq=False)
class TrackedDisplacements:
    """Displacements from the reference frame to every frame in mm, shape (3, t, y, x); NaN where a point is lost.

    ``stds``: Their standard deviations, of the same shape; None if the velocities state none.
    """

    values: Map
    stds: Map | None


def track_displacements(view: xr.Dataset, home: int, max_slope: float = _MAX_SLOPE) -> TrackedDisplacements:
    """Integrate the velocities along the paths of the points of a frame, by the trapezoidal rule.

    A point is lost where it leaves the image, where velocity or depth are not valid, or where another surface is seen:
    the depth differs by more than that of a surface of the maximum slope over a pixel. Errors of all frames are taken
    as fully correlated, since frames share images: standard deviations are summed.

    ``view``: Maps (t, y, x) of one camera. ``home``: Index of the reference frame.
    """
    camera = CameraRays.of(view)
    times = view["t"].values.astype(np.float64)
    sampler = _Sampler(view, camera, max_slope)
    start = camera.points(view["depth"].values[home].astype(np.float64))
    values = np.full((3, len(times), *start.shape[1:]), np.nan)
    stds = None if not sampler.has_std else np.full(values.shape, np.nan)
    first = sampler.at_pixels(home)
    values[:, home] = np.where(np.isfinite(first[0]), 0.0, np.nan)
    if stds is not None:
        stds[:, home] = values[:, home]
    for way in (1, -1):
        place, motion = start, first
        for n in range(home + way, len(times) if way > 0 else -1, way):
            step = times[n] - times[n - way]
            ahead = sampler.at_points(n, place + step * motion[:3])
            place = place + 0.5 * step * (motion[:3] + ahead[:3])
            later = sampler.at_points(n, place)
            values[:, n] = np.where(np.isfinite(later[:3]), place - start, np.nan)
            if stds is not None:
                stds[:, n] = stds[:, n - way] + 0.5 * abs(step) * (motion[3:] + later[3:])
            motion = later
    return TrackedDisplacements(values, stds)


class _Sampler:
    """Velocities, and their standard deviations, at points of frames."""

    def __init__(self, view: xr.Dataset, camera: CameraRays, max_slope: float) -> None:
        self._view, self._camera = view, camera
        self.has_std = "velocity_std" in view
        self._valid = find_valid_pixels(view, "velocity")
        self._apart = max_slope / camera.intrinsics.focal_length_px * max(camera.grid.step_px)

    def at_pixels(self, n: int) -> Map:
        """Return the velocity of a frame, followed by its standard deviation if stated, NaN where it is not valid."""
        names = ["velocity", *(["velocity_std"] if self.has_std else [])]
        fields = np.concatenate([self._view[name].values[:, n].astype(np.float64) for name in names])
        if self.has_std and "velocity_std_common" in self._view:
            common = self._view["velocity_std_common"].values[:, n].astype(np.float64)
            fields[3:] = np.sqrt(np.maximum(fields[3:] ** 2 - common**2, 0.0))
        return np.where(self._valid[n] & np.isfinite(fields[:3]).all(axis=0), fields, np.nan)

    def at_points(self, n: int, points: Map) -> Map:
        """Return the same at points (3, y, x), by bilinear interpolation between four valid pixels."""
        rows, columns = self._camera.pixels(points)
        usable = np.isfinite(columns) & np.isfinite(rows) & (points[2] > 0)
        places = np.where(usable, np.stack([rows, columns]), -9.0)
        depth = self._view["depth"].values[n].astype(np.float64)
        found = np.stack([_interpolated(each, places) for each in (depth, *self.at_pixels(n))])
        with np.errstate(invalid="ignore"):
            same = np.abs(found[0] - points[2]) <= self._apart * points[2]
        return np.where(usable & same, found[1:], np.nan)


def _interpolated(values: Map, places: Map) -> Map:
    missing = ~np.isfinite(values)
    filled = np.where(missing, 0.0, values)
    found = ndimage.map_coordinates(filled, places, order=1, mode="constant", cval=np.nan)
    lost = ndimage.map_coordinates(missing.astype(np.float64), places, order=1, mode="constant", cval=1.0)
    return np.where(lost > _ROUNDING, np.nan, found)


_ROUNDING = 1e-9

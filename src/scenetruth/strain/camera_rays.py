"""Rays of the pixels of maps, and pixels of points, with the distortion of the lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import Distortion
from scenetruth.schema import Intrinsics, read_intrinsics, read_scene
from scenetruth.scoring.error_pairs import PixelCoordinates, compute_pixel_coordinates

__all__ = ["CameraRays"]

Map = NDArray[np.float64]

_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


@dataclass(frozen=True, eq=False)
class CameraRays:
    """The camera of maps.

    ``grid``: Rows and columns of the pixels, in px of the full image.
    ``lens``: Its distortion; None for a pinhole camera.
    ``rays``: X / Z and Y / Z at the pixels, shape (2, y, x); NaN where the lens folds the image.
    """

    intrinsics: Intrinsics
    grid: PixelCoordinates
    lens: Distortion | None
    rays: Map

    @classmethod
    def of(cls, dataset: xr.Dataset) -> CameraRays:
        """Return the camera of a data set, with the distortion of its attribute or of its scene."""
        intrinsics, grid, lens = read_intrinsics(dataset), compute_pixel_coordinates(dataset), _read_lens(dataset)
        c_x, c_y = intrinsics.principal_point_px
        x, y = np.meshgrid((grid.x - c_x) / intrinsics.focal_length_px, (grid.y - c_y) / intrinsics.focal_length_px)
        rays = np.stack([x, y])
        if lens is not None:
            rays = np.moveaxis(lens.undistort(np.moveaxis(rays, 0, -1)), -1, 0)
        return cls(intrinsics, grid, lens, np.ascontiguousarray(rays))

    def points(self, depth: Map) -> Map:
        """Return the surface points in mm, camera frame, shape (3, y, x)."""
        return np.stack(
            [self.rays[0] * depth, self.rays[1] * depth, np.where(np.isfinite(self.rays[0]), depth, np.nan)]
        )

    def pixels(self, points: Map) -> tuple[Map, Map]:
        """Return the rows and columns of points (3, ...) in the arrays of the maps."""
        (c_x, c_y), f = self.intrinsics.principal_point_px, self.intrinsics.focal_length_px
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            rays = np.stack([points[0] / points[2], points[1] / points[2]], axis=-1)
            if self.lens is not None:
                rays = self.lens.distort(rays)
            columns = (f * rays[..., 0] + c_x - self.grid.x[0]) / self.grid.step_px[1]
            rows = (f * rays[..., 1] + c_y - self.grid.y[0]) / self.grid.step_px[0]
        return rows, columns


def _read_lens(dataset: xr.Dataset) -> Distortion | None:
    stated = np.atleast_1d(np.asarray(dataset.attrs.get("distortion", ()), dtype=np.float64))
    if stated.size:
        found = dict(zip(_ORDER, map(float, stated), strict=False))
    else:
        camera = (read_scene(dataset) or {}).get("camera") or {}
        lens = camera.get("distortion") or {}
        found = {name: float(lens.get(name) or 0.0) for name in _ORDER}
    return Distortion(**found) if any(found.values()) else None

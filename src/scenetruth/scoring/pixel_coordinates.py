"""Where the pixels of a map lie: in the whole image, and in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import Intrinsics

__all__ = ["PixelCoordinates", "coordinates_of", "surface_points"]

Map = NDArray[np.float64]


@dataclass(frozen=True)
class PixelCoordinates:
    """The pixels of a map, which may show a part of the image, or every other pixel of it, along x and y differently.

    `scenetruth.schema.PixelGrid` is the even and square grid that methods ask of a recording.

    Parameters
    ----------
    y, x
        The rows and columns of the whole image, shapes (y,) and (x,), in px.
    """

    y: Map
    x: Map

    @property
    def step_px(self) -> tuple[float, float]:
        """The distances between neighbouring pixels of the map, along y and along x, in px of the whole image."""
        return _step(self.y), _step(self.x)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The outer borders of the map's left, right, lower and upper pixels, in px of the whole image."""
        (height, width) = (0.5 * step for step in self.step_px)
        x, y = self.x, self.y
        return float(x[0] - width), float(x[-1] + width), float(y[-1] + height), float(y[0] - height)


def coordinates_of(dataset: xr.Dataset) -> PixelCoordinates:
    """Return the pixels of a data set, from its coordinates y and x; counted from 0 where it has none."""
    y, x = (
        np.asarray(dataset[dim].values if dim in dataset.coords else np.arange(dataset.sizes[dim]), dtype=np.float64)
        for dim in ("y", "x")
    )
    return PixelCoordinates(y, x)


def surface_points(depth: Map, intrinsics: Intrinsics, grid: PixelCoordinates | None = None) -> Map:
    """Return the surface points that pixels see.

    Parameters
    ----------
    depth
        Depth in mm, shape (y, x).
    intrinsics
        Of the camera.
    grid
        The pixels of the map; the whole image if not given.

    Returns
    -------
    numpy.ndarray
        X, Y and Z in mm in the camera's frame, shape (3, y, x).
    """
    c_x, c_y = intrinsics.principal_point_px
    y, x = (np.arange(size, dtype=np.float64) for size in depth.shape) if grid is None else (grid.y, grid.x)
    scale = depth / intrinsics.focal_length_px
    return np.stack([(x[None, :] - c_x) * scale, (y[:, None] - c_y) * scale, depth])


def _step(places: Map) -> float:
    return float(np.median(np.abs(np.diff(places)))) if places.size > 1 else 1.0

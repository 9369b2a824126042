"""Pixel grid of a data set: the full image, a crop or a subsampled image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, RecordingError
from scenetruth.lazy_exports import lazy_module
from scenetruth.schema.attributes import Intrinsics
from scenetruth.schema.outline import DatasetOutline

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["PixelGrid", "compute_pixel_grid", "pixel_grid_problems"]

_TOLERANCE = 1e-3  # relative tolerance of the steps, for coordinates stored as float32


@dataclass(frozen=True)
class PixelGrid:
    """Camera pixel index of the first array column and row, and distance between neighbouring columns (rows) in px."""

    first_x: float = 0.0
    first_y: float = 0.0
    step_px: float = 1.0

    def positions(self, height: int, width: int) -> list[NDArray[np.float64]]:
        """Return the column and row index of every pixel in camera pixels, each of shape (y, x)."""
        columns = self.first_x + self.step_px * np.arange(width)
        return list(np.meshgrid(columns, self.first_y + self.step_px * np.arange(height)))

    def in_columns(self, intrinsics: Intrinsics) -> Intrinsics:
        """Convert intrinsics from camera pixels to array columns and rows."""
        c_x, c_y = intrinsics.principal_point_px
        return replace(
            intrinsics,
            focal_length_px=intrinsics.focal_length_px / self.step_px,
            principal_point_px=((c_x - self.first_x) / self.step_px, (c_y - self.first_y) / self.step_px),
        )


def compute_pixel_grid(dataset: xr.Dataset) -> PixelGrid:
    """Compute the pixel grid from the coordinates ``x`` and ``y``; default: pixels from 0 on.

    The intrinsics of a data set always refer to camera pixels: a crop keeps its principal point, and a data set of
    every second pixel has a step of two pixels.

    >>> images = xr.Dataset(coords={"x": np.arange(20, 60, 2), "y": np.arange(0, 40, 2)})
    >>> compute_pixel_grid(images)
    PixelGrid(first_x=20.0, first_y=0.0, step_px=2.0)
    """
    problems = pixel_grid_problems(dataset)
    if problems:
        raise RecordingError(problems)
    steps = [step for step in (_step(dataset, "x"), _step(dataset, "y")) if step is not None]
    return PixelGrid(_first(dataset, "x"), _first(dataset, "y"), steps[0] if steps else 1.0)


def pixel_grid_problems(dataset: xr.Dataset | DatasetOutline) -> list[Problem]:
    """Return the problems of the coordinates ``x`` and ``y`` as a grid of square pixels."""
    problems = []
    for name in ("x", "y"):
        values = _values(dataset, name)
        if values is None or len(values) == 0:
            continue
        gaps = np.diff(values)
        even = np.all(gaps > 0) and np.allclose(gaps, gaps[:1], rtol=_TOLERANCE, atol=0)
        if not np.all(np.isfinite(values)) or not even:
            message = "must be equally spaced, increasing pixel indices; select with a slice of positive step"
            problems.append(Problem(name, message, values.tolist()))
    if not problems:
        step_x, step_y = _step(dataset, "x"), _step(dataset, "y")
        if step_x is not None and step_y is not None and not np.isclose(step_x, step_y, rtol=_TOLERANCE, atol=0):
            message = f"has a step of {step_y:g} px, but x of {step_x:g} px; subsample both dimensions equally"
            problems.append(Problem("y", message))
    return problems


def _values(
    dataset: xr.Dataset | DatasetOutline, name: str
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None:
    if name not in dataset.coords:
        return None
    values = dataset.variables[name].values
    if values.dtype.kind not in "iuf":
        return np.full(1, np.nan)
    return np.asarray(np.atleast_1d(values), dtype=np.float64)


def _first(dataset: xr.Dataset | DatasetOutline, name: str) -> float:
    values = _values(dataset, name)
    return 0.0 if values is None or len(values) == 0 else float(values[0])


def _step(dataset: xr.Dataset | DatasetOutline, name: str) -> float | None:
    """Return the mean step of a coordinate, or None for a single pixel."""
    values = _values(dataset, name)
    if values is None:
        return 1.0 if dataset.sizes.get(name, 1) > 1 else None
    return float((values[-1] - values[0]) / (len(values) - 1)) if len(values) > 1 else None

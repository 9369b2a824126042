"""Lens distortion: images are sampled where the lens shows a point, and maps are returned on the recorded pixels.

The fit works on the pixels of a pinhole camera of the same intrinsics, where its models of surface and motion hold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.schema import REASONS, compute_pixel_grid, read_acquisition, read_intrinsics
from scenetruth.threads import in_threads

__all__ = ["Lens", "as_pinhole", "compute_jacobian", "distort", "lens_problems", "read_lens", "undistort"]

Array = NDArray[np.float64]


def distort(coefficients: Array, points: Array) -> Array:
    """Return distorted positions of points (x, y), shape (2, ...), in units of the focal length.

    ``coefficients``: (k1, k2, p1, p2, k3, k4, k5, k6), as in OpenCV.
    """
    _, _, p1, p2, *_ = coefficients
    x, y = points
    square = x * x + y * y
    radial, _ = _radial(coefficients, square)
    right = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack([right, down])


def compute_jacobian(coefficients: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return dx_d / dx, dx_d / dy = dy_d / dx, and dy_d / dy at undistorted points."""
    _, _, p1, p2, *_ = coefficients
    x, y = points
    radial, slope = _radial(coefficients, x * x + y * y)
    return (
        radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
        2 * x * y * slope + 2 * p1 * x + 2 * p2 * y,
        radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


def _radial(coefficients: Array, square: Array) -> tuple[Array, Array]:
    """Return the radial factor and its derivative by the squared radius."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    above, below = (1 + square * (a + square * (b + square * c)) for a, b, c in ((k1, k2, k3), (k4, k5, k6)))
    slope = k1 + square * (2 * k2 + square * 3 * k3) - above / below * (k4 + square * (2 * k5 + square * 3 * k6))
    return above / below, slope / below


_STEPS, _CONVERGED = 50, 1e-13
_PATH = np.linspace(0.0, 1.0, 17)[1:]


def undistort(coefficients: Array, points: Array) -> Array:
    """Return the undistorted positions of points, shape (2, ...), by Newton's method; NaN where they are not unique."""
    found = np.array(points, dtype=np.float64)
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            left = distort(coefficients, found) - points
            a, b, d = compute_jacobian(coefficients, found)
            step = np.stack([d * left[0] - b * left[1], a * left[1] - b * left[0]]) / (a * d - b * b)
            found -= step
            if not (np.abs(step) > _CONVERGED).any():
                break
        away = ~(np.abs(distort(coefficients, found) - points).max(axis=0) < 1e-11)
        # Unique if the image does not fold anywhere between the axis and the point.
        for share in _PATH:
            a, b, d = compute_jacobian(coefficients, share * found)
            away |= ~(a * d - b * b > 0)
    found[:, away] = np.nan
    return found


_MARGIN = 1.05  # of the largest squared radius in the image; points beyond are outside

_BORDER = REASONS.index("border")


@dataclass(frozen=True, eq=False)
class Lens:
    """Distortion of the images of a recording, in columns."""

    coefficients: Array
    focal: float
    centre: tuple[float, float]
    shape: tuple[int, int]

    @cached_property
    def kernel(self) -> Array:
        """Coefficients for `warp.corrected`, followed by the largest squared radius."""
        largest = np.square(self._undistorted()).sum(axis=0).max()
        return np.append(self.coefficients, _MARGIN * largest)

    def part(self, left: int, top: int, shape: tuple[int, int]) -> Lens:
        """Return the lens for a part of the image that begins at a column and row."""
        part = replace(self, centre=(self.centre[0] - left, self.centre[1] - top), shape=shape)
        part.__dict__["kernel"] = self.kernel
        return part

    def straighten(self, images: NDArray[Any]) -> NDArray[np.float32]:
        """Return images, shape (..., y, x), as of a pinhole camera; beyond their border, the nearest values."""
        from scipy.ndimage import map_coordinates

        at = self._distorted()[::-1]
        out = np.empty(images.shape, dtype=np.float32)

        def resample(index: tuple[int, ...]) -> None:
            out[index] = map_coordinates(images[index].astype(np.float64), at, order=3, mode="nearest")

        in_threads(partial(resample), list(np.ndindex(images.shape[:-2])))
        return out

    def sample(self, coefficients: Array, order: int, origin: Array | None = None) -> Array:
        """Return an image as of a pinhole camera, from its spline coefficients, shape (y, x).

        ``origin``: Column and row at which the coefficients begin; None for 0.
        """
        from scipy.ndimage import map_coordinates

        at = self._distorted()[::-1]
        if origin is not None:
            at = at - origin[::-1, None, None]
        return np.asarray(map_coordinates(coefficients, at, order=order, mode="nearest", prefilter=False))

    def put_back(self, maps: dict[str, Any], spread_px: float) -> dict[str, Any]:
        """Return maps, shape (..., y, x), at the recorded pixels, with the flow of the distorted images.

        Maps are interpolated linearly where the four pixels around a position are valid and their disparities, or
        flows, differ by less than ``spread_px``: one surface. Elsewhere, they are those of the nearest pixel.
        """
        height, width = self.shape
        undistorted = self._undistorted()
        x, y = (self.focal * part + centre for part, centre in zip(undistorted, self.centre, strict=True))
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        left, top = (np.minimum(at.astype(np.intp), size - 2) for at, size in ((x, width), (y, height)))
        u, v = x - left, y - top
        corners = [(top + i, left + j, (v if i else 1 - v) * (u if j else 1 - u)) for i in (0, 1) for j in (0, 1)]
        near = np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)
        given = (maps[name] for name in ("disparity", "flow") if name in maps)
        guide = next((each for each in given if np.isfinite(each).any()), np.zeros(self.shape))
        values = np.stack([guide[..., rows, columns] for rows, columns, _ in corners])
        one = np.ptp(values, axis=0) < spread_px
        one &= np.all([maps["status"][rows, columns] == maps["status"][near] for rows, columns, _ in corners], axis=0)
        one = one.all(axis=tuple(range(one.ndim - 2)))
        found: dict[str, Any] = {}
        for name, each in maps.items():
            nearest = each[(..., *near)]
            if each.dtype.kind == "f":
                smooth = sum(weight * each[..., rows, columns] for rows, columns, weight in corners)
                nearest = np.where(inside, np.where(one & np.isfinite(smooth), smooth, nearest), np.nan)
            found[name] = nearest.astype(each.dtype)
        for name in ("status", "valid", "surface_model", "motion_model", "image_count"):
            if name in found:
                found[name][~inside] = 0
        found["invalid_reason"][~inside] = _BORDER
        if "flow" in found:
            a, b, d = compute_jacobian(self.coefficients, undistorted)
            along, down = found["flow"].astype(np.float64)
            found["flow"] = np.stack([a * along + b * down, b * along + d * down]).astype(found["flow"].dtype)
        return found

    def _pixels(self) -> Array:
        height, width = self.shape
        y, x = np.mgrid[:height, :width].astype(np.float64)
        return np.stack([x - self.centre[0], y - self.centre[1]]) / self.focal

    def _distorted(self) -> Array:
        """Return column and row where the images show the pixels of the pinhole camera."""
        centre = np.array(self.centre)[:, None, None]
        return np.asarray(self.focal * distort(self.coefficients, self._pixels()) + centre)

    def _undistorted(self) -> Array:
        return undistort(self.coefficients, self._pixels())


def read_lens(recording: xr.Dataset) -> Lens | None:
    """Return the lens of a recording, None for a pinhole camera."""
    coefficients = read_acquisition(recording).distortion
    if not coefficients.size:
        return None
    intrinsics = compute_pixel_grid(recording).in_columns(read_intrinsics(recording))
    shape = (recording.sizes["y"], recording.sizes["x"])
    return Lens(coefficients, intrinsics.focal_length_px, intrinsics.principal_point_px, shape)


def lens_problems(recording: xr.Dataset) -> list[Problem]:
    """Return a problem if the distortion folds the image."""
    lens = read_lens(recording)
    if lens is None or np.isfinite(lens._undistorted()).all():
        return []
    row, column = np.argwhere(~np.isfinite(lens._undistorted()[0]))[0].tolist()
    message = f"is not invertible at row {row}, column {column}: the lens would fold the image; check the coefficients"
    return [Problem("attrs.distortion", message, str(lens.coefficients.tolist()))]


def as_pinhole(recording: xr.Dataset, lens: Lens | None) -> xr.Dataset:
    """Return a recording with simultaneous images of a pinhole camera, for an initial estimate."""
    made = recording.drop_vars("planned_time_s", errors="ignore")
    dropped = ("distortion", "distortion_std", "line_time_s", "stage_speed_mm_per_s")
    made.attrs = {name: value for name, value in recording.attrs.items() if name not in dropped}
    if lens is None:
        return made
    image = recording["image"]
    colours = "channel" in image.dims
    found = lens.straighten(np.moveaxis(image.values, -1, 0) if colours else image.values)
    return made.assign(image=(image.dims, np.moveaxis(found, 0, -1) if colours else found, image.attrs))

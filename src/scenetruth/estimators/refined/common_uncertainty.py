"""Uncertainty that all pixels have in common: poses and distances of the stage, focal length, principal point, lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.acquisition import corrects_poses
from scenetruth.schema import compute_pixel_grid, read_acquisition, read_intrinsics

__all__ = [
    "CalibrationUncertainty",
    "CommonVariance",
    "compute_common_variance",
    "has_common_part",
    "read_calibration_uncertainty",
]

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibrationUncertainty:
    """Standard deviations of what images do not determine, in columns."""

    scale: float = 0.0
    """Relative, of the distances along the stage."""
    focal: float = 0.0
    """Relative, of the focal length."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Of the principal point, relative to the focal length."""
    lens: Map | None = None
    """Relative, of distances along x and y in the image, due to the distortion, shape (2, y, x)."""
    displacements: Map | None = None
    """Of points of the image along x and y in columns, due to each coefficient of the distortion, (n, 2, y, x)."""


@dataclass(frozen=True, eq=False)
class CommonVariance:
    """Variances that are not independent from pixel to pixel."""

    disparity: Map
    """In squares of columns per step, shape (y, x)."""
    depth: Map
    """Relative, shape (y, x)."""
    velocity: Map
    """In squares of steps per frame, shape (3, y, x)."""


def has_common_part(recording: xr.Dataset, settings: RefinedSettings) -> bool:
    """Return whether stage or lens have stated errors, so that the estimate states their part."""
    return corrects_poses(recording, settings) or read_acquisition(recording).tolerances_stated


def read_calibration_uncertainty(recording: xr.Dataset) -> CalibrationUncertainty:
    """Read the stated uncertainty of lens and distances."""
    acquisition, intrinsics = read_acquisition(recording), read_intrinsics(recording)
    focal = intrinsics.focal_length_px
    across, down = (value / focal for value in acquisition.principal_point_std_px)
    scale = 1e-6 * acquisition.stage.scale_ppm
    moved = _displacements(recording) if np.any(acquisition.distortion_std) else None
    # Of short distances along x and y.
    lens = None if moved is None else np.sqrt(np.stack([_square_slope(moved[:, k], 1 - k) for k in (0, 1)]))
    return CalibrationUncertainty(scale, acquisition.focal_length_std_px / focal, (across, down), lens, moved)


def compute_common_variance(uncertainty: CalibrationUncertainty, poses: Map | None, d: Map, q: Map) -> CommonVariance:
    """Return the variances of disparity, depth and velocity from calibration and poses.

    ``poses``: Variances of d, q_X, q_Y, q_Z due to the poses, shape (4, y, x), or None.
    ``d``, ``q``: Disparity, shape (y, x), and velocity in steps per frame, shape (3, y, x).
    """
    poses = np.zeros((4, *d.shape)) if poses is None else poses
    lens = np.zeros((2, *d.shape)) if uncertainty.lens is None else uncertainty.lens
    # Distances along the stage are the unit of all lengths.
    disparity = poses[0] + d**2 * (uncertainty.scale**2 + lens[0] ** 2)
    depth = poses[0] / d**2 + uncertainty.scale**2 + lens[0] ** 2 + uncertainty.focal**2
    velocity = poses[1:] + q**2 * uncertainty.scale**2
    # The flow d q_X - x d q_Z / f is measured, and so is q_Z / f; distances along x and y differ by the lens.
    velocity[0] += (q[2] * uncertainty.centre[0]) ** 2
    velocity[1] += (q[2] * uncertainty.centre[1]) ** 2 + q[1] ** 2 * (lens[0] ** 2 + lens[1] ** 2)
    velocity[2] += (q[2] * uncertainty.focal) ** 2
    return CommonVariance(disparity, depth, velocity)


def _square_slope(moved: Map, axis: int) -> Map:
    return np.asarray(np.square([np.gradient(each, axis=axis) for each in moved]).sum(axis=0))


def _displacements(recording: xr.Dataset) -> Map:
    """Return the displacements of points by one standard deviation of each uncertain distortion coefficient."""
    from scenetruth.estimators.refined.lens_distortion import distort

    acquisition, grid = read_acquisition(recording), compute_pixel_grid(recording)
    intrinsics = grid.in_columns(read_intrinsics(recording))
    height, width = recording.sizes["y"], recording.sizes["x"]
    y, x = np.mgrid[:height, :width].astype(np.float64)
    c_x, c_y = intrinsics.principal_point_px
    at = np.stack([x - c_x, y - c_y]) / intrinsics.focal_length_px
    lens = acquisition.distortion if acquisition.distortion.size else np.zeros(8)
    own, found = distort(lens, at), []
    for place in np.flatnonzero(acquisition.distortion_std):
        changed = lens.copy()
        changed[place] += acquisition.distortion_std[place]
        found.append((distort(changed, at) - own) * intrinsics.focal_length_px)
    return np.stack(found)

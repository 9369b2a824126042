"""Camera geometry: transformations between pixels, rays and points of the world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.exporters.export_source import ExportSource
from scenetruth.schema import read_scene

__all__ = ["CameraPose", "compute_pose", "distort", "point_problems", "points_in_world", "project"]

Array = NDArray[np.float64]

_MOST_STEPS, _REACHED = 500, 1e-13


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Pose of a camera.

    ``centre_mm``: Projection centre in the world, shape (3,).
    ``axes``: Axes X, Y, Z in the world as columns, shape (3, 3).
    """

    centre_mm: Array
    axes: Array

    @property
    def translation_mm(self) -> Array:
        """Translation t of x = R X + t, where R is the transpose of `axes`."""
        return np.asarray(-self.axes.T @ self.centre_mm)


def poses_are_real(source: ExportSource) -> bool:
    """Return whether the maps refer to the actual camera poses."""
    return "camera_position_mm" in source.maps and source.maps.attrs.get("truth_poses", "actual") == "actual"


def compute_pose(source: ExportSource, s: int, t: int, *, real: bool | None = None) -> CameraPose:
    """Return the pose of a camera in a frame."""
    if poses_are_real(source) if real is None else real:
        from scipy.spatial.transform import Rotation

        place, turn = (source.maps[name].sel(s=s, t=t).values for name in ("camera_position_mm", "camera_rotation_rad"))
        axes = np.asarray(Rotation.from_rotvec(np.asarray(turn, dtype=np.float64)).as_matrix())
        return CameraPose(np.asarray(place, dtype=np.float64), axes)
    along = float(source.recording["stage_x_mm"].sel(s=s))
    # Row of a camera grid.
    down = float(source.recording["stage_y_mm"]) if "stage_y_mm" in source.recording.coords else 0.0
    return CameraPose(np.array([along, down, 0.0]), np.eye(3))


def point_problems(source: ExportSource) -> Iterator[Problem]:
    """Yield the reasons why pixels have no points in the world."""
    if "depth" not in source.maps and "disparity" not in source.maps:
        yield Problem("depth", "is missing, and disparity too: there are no points")
    shutter = (read_scene(source.recording) or {}).get("shutter") or {}
    speed = shutter.get("stage_speed_mm_per_s") or 0.0
    if source.is_truth and speed and shutter.get("readout_time_s"):
        message = "during readout: every row has a different camera position, and poses refer to the middle row"
        yield Problem("shutter.stage_speed_mm_per_s", f"moves the camera {message}; export exr or npz", speed)


def points_in_world(source: ExportSource, s: int, t: int) -> Array:
    """Return the surface points at the pixels of a camera, in the world, mm, shape (3, y, x); NaN where none."""
    height, width = source.size
    own = source.intrinsics
    c_x, c_y = own.principal_point_px
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    rays = np.stack([(columns - c_x) / own.focal_length_px, (rows - c_y) / own.focal_length_px])
    if source.distortion:
        rays = _undistort(rays, source.distortion)
    in_camera = np.concatenate([rays, np.ones((1, height, width))]) * source.depth(s, t)
    pose = compute_pose(source, s, t)
    return np.asarray(np.einsum("ij,jyx->iyx", pose.axes, in_camera) + pose.centre_mm[:, None, None])


def project(source: ExportSource, points_mm: Array, pose: CameraPose) -> Array:
    """Return the projections of points of the world into a camera, in columns and rows."""
    x, y, z = pose.axes.T @ (points_mm - pose.centre_mm[:, None])
    z = np.where(z > 0, z, np.nan)
    plane = distort(np.stack([x / z, y / z]), source.distortion)
    own = source.intrinsics
    return np.asarray(own.focal_length_px * plane + np.array(own.principal_point_px)[:, None])


def distort(points: Array, coefficients: Mapping[str, float]) -> Array:
    """Return points (x, y) at unit distance after Brown-Conrady distortion, shape (2, ...)."""
    if not coefficients:
        return points
    radial, shift = _lens(points, coefficients)
    return points * radial + shift


def _lens(points: Array, coefficients: Mapping[str, float]) -> tuple[Array, Array]:
    k1, k2, k3, k4, k5, k6, p1, p2 = (
        coefficients.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
    )
    x, y = points
    square = x * x + y * y
    radial = (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)))
    shift = [2 * p1 * x * y + p2 * (square + 2 * x * x), p1 * (square + 2 * y * y) + 2 * p2 * x * y]
    return radial, np.stack(shift)


def _undistort(points: Array, coefficients: Mapping[str, float]) -> Array:
    """Return the inverse of `distort`; NaN without convergence, for example where a lens folds the image."""
    found = points.copy()
    with np.errstate(all="ignore"):
        for _ in range(_MOST_STEPS):
            radial, shift = _lens(found, coefficients)
            later = (points - shift) / radial
            moved = np.abs(later - found)
            found = later
            if not (moved > _REACHED).any():
                break
        away = ~(np.abs(distort(found, coefficients) - points).max(axis=0) < 10 * _REACHED)
    return np.where(away, np.nan, found)

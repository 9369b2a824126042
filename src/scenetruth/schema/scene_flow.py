"""Conversion between optical flow, depth and velocity (paper, eq. 2 to 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.schema.attributes import Intrinsics

__all__ = ["depth_from_disparity", "depth_rate_along", "depth_rate_at", "flow_from_velocity", "velocity_from_flow"]

Map = NDArray[np.float64]


def depth_from_disparity(disparity: Map, intrinsics: Intrinsics) -> Map:
    """Return Z = f V_X / d in mm from disparity d in px per step of s; also converts depth into disparity."""
    return intrinsics.focal_length_px * intrinsics.baseline_mm / disparity


def velocity_from_flow(flow: Map, depth: Map, depth_rate: Map, grid: Sequence[Map], intrinsics: Intrinsics) -> Map:
    """Return the velocity (U_X, U_Y, U_Z) of surface points in mm per frame, shape (3, t, y, x).

    The derivative of x = f X / Z gives U_X = (Z dx/dt + x U_Z) / f, and likewise U_Y.

    ``flow``: (dx/dt, dy/dt) in px per frame, shape (2, t, y, x).
    ``depth``, ``depth_rate``: Z in mm and U_Z in mm per frame, shape (t, y, x).
    ``grid``: Column and row of every pixel in px, each of shape (y, x), as for the intrinsics.
    """
    across = [
        (depth * part + (at - centre) * depth_rate) / intrinsics.focal_length_px
        for part, at, centre in zip(flow, grid, intrinsics.principal_point_px, strict=True)
    ]
    return np.stack([*across, np.broadcast_to(depth_rate, depth.shape)])


def flow_from_velocity(velocity: Map, depth: Map, grid: Sequence[Map], intrinsics: Intrinsics) -> Map:
    """Return the flow in px per frame, dx/dt = (f U_X - x U_Z) / Z and likewise dy/dt, shape (2, t, y, x)."""
    parts = [
        (intrinsics.focal_length_px * part - (at - centre) * velocity[2]) / depth
        for part, at, centre in zip(velocity[:2], grid, intrinsics.principal_point_px, strict=True)
    ]
    return np.stack(parts)


def depth_rate_along(depth: Map, flow: Map, frames: NDArray[np.int64], grid: Sequence[Map]) -> Map:
    """Return the rate of depth of surface points in mm per frame for ``frames``, shape (t, y, x), see `depth_rate_at`.

    ``depth``, ``flow``: Z in mm, shape (t, y, x); (dx/dt, dy/dt) in px per frame, shape (2, t, y, x).
    """
    depths = dict(zip(frames.tolist(), depth, strict=True))
    rate = np.empty_like(depth)
    for n, t in enumerate(frames.tolist()):
        near = {step: depths[t + step] for step in (-1, 1) if t + step in depths}
        rate[n] = depth_rate_at(depth[n], flow[:, n], near, grid)
    return rate


def depth_rate_at(depth: Map, flow: Map, near: Mapping[int, Map], grid: Sequence[Map]) -> Map:
    """Return the rate of depth of surface points from the depth of neighbouring frames along the flow.

    Depth is interpolated bilinearly at (x, y) + flow in frame t + 1 and at (x, y) - flow in frame t - 1. The rate is
    the central difference, or a one-sided difference with a single neighbour. For steady flow the error is of second
    order in the frame interval for the central and of first order for the one-sided difference.

    ``depth``, ``flow``: Z in mm, shape (y, x); (dx/dt, dy/dt) in px per frame, shape (2, y, x).
    ``grid``: Column and row of every pixel in px, equally spaced, each of shape (y, x).
    Returns: dZ/dt in mm per frame, shape (y, x); NaN where the point is visible in no neighbouring frame.
    """
    from scipy.ndimage import map_coordinates

    columns, rows = grid
    steps = [float(line[1] - line[0]) if len(line) > 1 else 1.0 for line in (columns[0], rows[:, 0])]
    row, column = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float64)
    sides = []
    for step, other in near.items():
        at = (row + step * flow[1] / steps[1], column + step * flow[0] / steps[0])
        unknown = ~np.isfinite(at[0] + at[1])
        places = np.where(unknown, -1.0, np.stack(at))
        values = map_coordinates(other, places, order=1, cval=np.nan)
        sides.append(step * (np.where(unknown, np.nan, values) - depth))
    if not sides:
        return np.full(depth.shape, np.nan)
    with np.errstate(invalid="ignore"):
        both = np.stack(sides)
        count = np.isfinite(both).sum(axis=0)
        return np.where(count > 0, np.nansum(both, axis=0) / np.maximum(count, 1), np.nan)

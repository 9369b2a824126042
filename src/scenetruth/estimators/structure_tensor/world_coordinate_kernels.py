"""Kernel that converts the null space of every pixel into depth, scene flow and their standard deviations."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.structure_tensor.maps import BestRegistration, EstimateMaps, Texture
from scenetruth.kernels import kernel, subkernel

__all__ = ["Axes", "NoisePower", "WorkingPoints", "to_world"]

_NONE, _NORMAL, _FULL = 0, 1, 2
# Largest residual displacement between two cameras or two frames at the best of several registrations, in px.
_MOST_LEFT = 1.0


class Axes(NamedTuple):
    """Pinhole camera, stage and frames."""

    focal_length_px: float
    centre_x_px: float
    """Principal point."""
    centre_y_px: float
    baseline_mm: float
    """V_X."""
    centre_s: float
    """Centre of the estimates, in steps of s and t from the reference."""
    centre_t: float
    scale_s: float
    """Factors of g_s and g_t that equalise the noise of all derivatives."""
    scale_t: float
    sees_depth: bool
    sees_motion: bool


class WorkingPoints(NamedTuple):
    """Integer shifts of the registrations, shape (n,), and whether they differ among the registrations."""

    disparity: NDArray[np.float64]
    flow_x: NDArray[np.float64]
    flow_y: NDArray[np.float64]
    several_disparities: bool
    several_flows_x: bool
    several_flows_y: bool


class NoisePower(NamedTuple):
    """Power of the image noise and its propagation (`NoiseModel`)."""

    power: float
    """If not finite, it is estimated from the residual of each pixel."""
    residual_s: tuple[float, float]
    residual_t: tuple[float, float]
    window: float
    motion_s: float
    phases: NDArray[np.float64]
    disparity_s: NDArray[np.float64]
    disparity_t: NDArray[np.float64]
    motion_t: NDArray[np.float64]


@subkernel()
def _look_up(phase: float, phases: Any, table: Any) -> float:
    """Interpolate a table linearly, with constant extrapolation."""
    position = min(phase / phases[1], len(phases) - 1.0)
    index = min(int(position), len(phases) - 2)
    part = position - index
    return float((1.0 - part) * table[index] + part * table[index + 1])


@kernel()
def to_world(
    axes: Axes,
    points: WorkingPoints,
    noise: NoisePower,
    texture: Texture,
    best: BestRegistration,
    maps: EstimateMaps,
    frame: int,
    first_row: int,
    rows: tuple[int, int],
) -> None:
    """Compute world coordinates (paper, end of section 3), pixel by pixel, in maps that are invalid everywhere."""
    elsewhere = axes.centre_s != 0.0 or axes.centre_t != 0.0
    for y in range(rows[0], rows[1]):
        row = first_row + y
        for x in range(best.choice.shape[2]):
            at, out = (frame, y, x), (frame, row, x)
            if best.choice[at] < 0:
                continue
            for k in range(5):
                maps.eigenvalues[k, frame, row, x] = best.eigenvalues[frame, k, y, x]
            point = best.choice[at]
            left_v = best.v_x[at] / axes.scale_s
            left_x, left_y = best.flow_x[at] / axes.scale_t, best.flow_y[at] / axes.scale_t
            # With several registrations, a better one lies outside the common view, or does not exist.
            if (
                (points.several_disparities and abs(left_v) > _MOST_LEFT)
                or (points.several_flows_x and abs(left_x) > _MOST_LEFT)
                or (points.several_flows_y and abs(left_y) > _MOST_LEFT)
            ):
                continue
            disparity = points.disparity[point] - left_v
            flow_x, flow_y = points.flow_x[point] + left_x, points.flow_y[point] + left_y
            full_motion = best.kind_motion[at] == _FULL
            u_z = (best.certain_u_z[at] if full_motion else best.u_z[at]) / axes.scale_t
            depth = axes.focal_length_px * axes.baseline_mm / disparity if disparity != 0.0 else np.nan
            seen_s = axes.sees_depth and np.isfinite(depth) and depth > 0.0
            seen_t = axes.sees_motion and np.isfinite(flow_x + flow_y + u_z)
            kind_s = best.kind_disparity[at] if seen_s else _NONE
            kind_t = best.kind_motion[at] if seen_t else _NONE
            maps.kind_disparity[out], maps.kind_motion[out] = kind_s, kind_t
            both = axes.sees_depth and axes.sees_motion
            maps.kind[out] = min(kind_s, kind_t) if both else max(kind_s, kind_t)
            if kind_s == _NONE and kind_t == _NONE:
                continue
            maps.model_violation[out] = best.model_violation[at]
            maps.working_point[out] = points.disparity[point]
            three, four = best.eigenvalues[frame, 2, y, x], best.eigenvalues[frame, 3, y, x]
            gap = max((three - four) / (three + four), 0.0) if three + four > 0.0 else 0.0
            maps.confidence[out] = min(gap * gap, 1.0)

            # Virtual camera between the cameras, instant between the frames.
            x_0 = x - axes.centre_x_px - points.disparity[point] * axes.centre_s + points.flow_x[point] * axes.centre_t
            y_0 = row - axes.centre_y_px + points.flow_y[point] * axes.centre_t
            first_x, first_y = x_0, y_0
            u_x, u_y = flow_x - x_0 * u_z, flow_y - y_0 * u_z
            if kind_t == _NONE:
                u_x = u_y = u_z = 0.0
            if elsewhere:
                closer = 1.0 + u_z * axes.centre_t
                seen = x_0 + (disparity * axes.centre_s if axes.centre_s != 0.0 else 0.0)
                x_0, y_0 = (seen - u_x * axes.centre_t) / closer, (y_0 - u_y * axes.centre_t) / closer
                disparity, depth = disparity / closer, depth * closer
                u_x, u_y, u_z = u_x / closer, u_y / closer, u_z / closer
                maps.shift[0, frame, row, x] = x_0 + axes.centre_x_px - x
                maps.shift[1, frame, row, x] = y_0 + axes.centre_y_px - row

            spot = y // texture.stride, x // texture.stride
            k_x, k_y = texture.wave_number_x2[spot], texture.wave_number_y2[spot]
            phase_t = np.sqrt(k_x * left_x * left_x + k_y * left_y * left_y)
            relative = 0.0
            if kind_s != _NONE:
                maps.depth[out], maps.disparity[out] = depth, disparity
                v = best.length_s[at] if full_motion else best.v_x[at]
                of_unit = noise.residual_s[0] + noise.residual_s[1] * v * v
                from_s = noise.power if np.isfinite(noise.power) else max(best.residual_s[at], 0.0) / of_unit
                along_s = _look_up(np.sqrt(k_x) * abs(left_v), noise.phases, noise.disparity_s)
                passed = along_s * texture.passed_x[spot] * noise.window
                if kind_t == _FULL or not axes.sees_motion:
                    passed *= _look_up(phase_t, noise.phases, noise.disparity_t)
                else:
                    passed *= noise.disparity_t[0]
                std = np.sqrt(from_s * passed * best.variance_v_x[at]) / axes.scale_s
                relative = std / abs(disparity)
                maps.depth_std[out], maps.disparity_std[out] = depth * relative, std
            if kind_t == _NONE:
                continue
            maps.flow[0, frame, row, x], maps.flow[1, frame, row, x] = u_x + x_0 * u_z, u_y + y_0 * u_z
            maps.divergence[out] = u_z
            if kind_s == _NONE:
                continue
            mm = depth / axes.focal_length_px
            maps.velocity[0, frame, row, x], maps.velocity[1, frame, row, x] = u_x * mm, u_y * mm
            maps.velocity[2, frame, row, x] = -u_z * depth
            if kind_t != _FULL:
                continue
            p1, p2 = best.flow_x[at], best.flow_y[at]
            from_t = noise.power
            if not np.isfinite(noise.power):
                of_unit = noise.residual_t[0] + noise.residual_t[1] * (p1 * p1 + p2 * p2)
                from_t = max(best.residual_t[at], 0.0) / of_unit
            along_t = _look_up(phase_t, noise.phases, noise.motion_t)
            passed = from_t * texture.passed_xy[spot] * noise.window * noise.motion_s * along_t
            passed /= axes.scale_t * axes.scale_t
            c33 = texture.widened[spot] * best.variance_u_z[at]
            c13, c23 = best.covariance_x_z[at], best.covariance_y_z[at]
            across = passed * (best.variance_flow_x[at] - 2.0 * first_x * c13 + first_x * first_x * c33)
            down = passed * (best.variance_flow_y[at] - 2.0 * first_y * c23 + first_y * first_y * c33)
            maps.velocity_std[0, frame, row, x] = mm * np.sqrt(across + (u_x * relative) ** 2)
            maps.velocity_std[1, frame, row, x] = mm * np.sqrt(down + (u_y * relative) ** 2)
            maps.velocity_std[2, frame, row, x] = depth * np.sqrt(passed * c33 + (u_z * relative) ** 2)

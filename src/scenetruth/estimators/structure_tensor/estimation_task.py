"""Inputs of an estimation that all registrations, rows and frames share, and subpixel shifts of the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, maximum_filter1d, spline_filter1d

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.channel_noise import CorrelatedNoise
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.filters import PAPER, REACH, AcquisitionAxes, FilterPair
from scenetruth.estimators.structure_tensor.noise_model import NoiseModel, propagate_noise
from scenetruth.estimators.structure_tensor.registration import Rectangle, Registration
from scenetruth.schema import Intrinsics

__all__ = [
    "EstimationInputs",
    "check_common_view",
    "columns_of_s",
    "common_area",
    "largest_disparity",
    "make_inputs",
    "shift_by_subpixels",
    "without_support",
]


_WHOLE = 1e-9  # px from a whole number of columns by rounding
_SPLINE_REACH_PX = 16  # columns on either side that affect a shifted pixel; the weights beyond are below 2e-6


@dataclass(frozen=True, eq=False)
class EstimationInputs:
    """Inputs of an estimation."""

    images: NDArray[Any]
    """Images, shape (channel, s, t, y, x)."""
    rig: AcquisitionAxes
    settings: StructureTensorSettings
    intrinsics: Intrinsics
    over_s: FilterPair
    """Filters along s for grey values, the derivative scaled to the noise of the other derivatives."""
    over_t: FilterPair
    scales: tuple[float, float]
    """Scale factors of the derivatives along s and t."""
    noise: NoiseModel
    outputs: NDArray[np.int64]
    """Indices of the frames to estimate."""
    weights: NDArray[np.float64]
    """Weights of the channels in the tensor; 1 unless their noise differs."""
    contrast_share: float = 1.0
    """Number of channels with the largest weighted contrast that have as much as all channels, relative to all."""

    @cached_property
    def invalid(self) -> NDArray[np.bool_] | None:
        """Pixels without a grey value (NaN), shape (s, t, y, x); None if there are none."""
        if self.images.dtype.kind != "f":
            return None
        found = np.isnan(self.images).any(axis=0)
        return found if found.any() else None


def make_inputs(
    images: NDArray[Any],
    rig: AcquisitionAxes,
    settings: StructureTensorSettings,
    intrinsics: Intrinsics,
    full_scale: float,
    correlated: CorrelatedNoise | None = None,
) -> EstimationInputs:
    """Return the inputs for images (channel, s, t, y, x), with filters scaled to grey values and to equal noise."""
    # Grey values in [-1, 1] are 2 image / full scale - 1; derivatives do not depend on the constant.
    grey = 2 / full_scale
    # Total least squares assumes equal errors in all derivatives.
    equal = np.sqrt(PAPER.noise_ratio)
    scale_s = equal / np.sqrt(rig.over_s.noise_ratio) if rig.sees_depth else 1.0
    scale_t = equal / np.sqrt(rig.over_t.noise_ratio) if rig.sees_motion else 1.0
    over_s = replace(rig.over_s, derivative=rig.over_s.derivative * scale_s)
    over_t = replace(rig.over_t, derivative=rig.over_t.derivative * scale_t)
    noise = propagate_noise(rig, over_s, over_t, images.shape[0], settings)
    if correlated is not None:
        more = correlated.of_residuals if settings.noise_std == "auto" else correlated.of_pixels
        noise = replace(noise, window=noise.window * more)
    return EstimationInputs(
        images=images,
        rig=rig,
        settings=settings,
        intrinsics=intrinsics,
        over_s=replace(over_s, smoothing=over_s.smoothing * grey, derivative=over_s.derivative * grey),
        over_t=over_t,
        scales=(float(scale_s), float(scale_t)),
        noise=noise,
        outputs=rig.outputs(images.shape[2]),
        weights=np.ones(len(images)),
    )


def columns_of_s(rig: AcquisitionAxes, disparity: int) -> NDArray[np.int64]:
    """Return the column offset (int64) at which the image of each camera is read for a disparity in px per step."""
    return -np.rint(disparity * rig.positions).astype(np.int64)


def common_area(task: EstimationInputs, registration: Registration) -> Rectangle:
    """Return the pixels whose filters and window lie inside all registered images."""
    height, width = task.images.shape[-2:]
    reach = REACH + task.settings.window_taps_px // 2
    after = task.rig.frames - 1 - task.rig.before
    x = np.add.outer(
        columns_of_s(task.rig, registration.disparity), registration.flow[0] * np.array([-task.rig.before, after])
    )
    y = registration.flow[1] * np.array([-task.rig.before, after])
    return Rectangle(
        top=max(0, -int(y.min())) + reach,
        bottom=height - max(0, int(y.max())) - reach,
        left=max(0, -int(x.min())) + reach,
        right=width - max(0, int(x.max())) - reach,
    )


def largest_disparity(task: EstimationInputs) -> int:
    """Return the largest disparity (px per step of s) at which the registered images overlap by filters and window."""
    width = task.images.shape[-1]
    reach = REACH + task.settings.window_taps_px // 2
    span = task.rig.positions.max() - task.rig.positions.min()
    return int((width - 2 * reach - 1) / max(span, 1.0))


def without_support(
    task: EstimationInputs, registration: Registration, index: int, rows: tuple[int, int]
) -> NDArray[np.bool_] | None:
    """Return the pixels of a row band whose filters and window touch an invalid pixel; None if there are none.

    ``index``: Index of the frame among those to estimate.
    """
    if task.invalid is None:
        return None
    height, width = task.images.shape[-2:]
    reach = REACH + task.settings.window_taps_px // 2
    top, bottom = rows[0] - reach, rows[1] + reach
    touched = np.zeros((bottom - top, width), dtype=np.uint8)
    first = int(task.outputs[index]) - task.rig.before
    parts = _subpixel_parts(task.rig, registration.disparity)
    for s, column in enumerate(columns_of_s(task.rig, registration.disparity).tolist()):
        for frame in range(task.rig.frames):
            ahead = frame - task.rig.before
            right, down = column + registration.flow[0] * ahead, registration.flow[1] * ahead
            at = np.clip((top + down, bottom + down), 0, height)
            source = task.invalid[s, first + frame, at[0] : at[1]].view(np.uint8)
            if not source.any():
                continue
            if abs(parts[s]) >= _WHOLE:
                source = maximum_filter1d(source, 2 * _SPLINE_REACH_PX + 1, axis=1, mode="constant")
            left, end = np.clip((-right, width - right), 0, width)
            touched[at[0] - top - down : at[1] - top - down, left:end] |= source[:, left + right : end + right]
    if not touched.any():
        return None
    for axis in (0, 1):
        touched = maximum_filter1d(touched, 2 * reach + 1, axis=axis, mode="constant")
    return np.asarray(touched[reach : len(touched) - reach] > 0)


def check_common_view(task: EstimationInputs, registrations: Sequence[Registration]) -> None:
    """Raise if the images of no registration overlap by filters and window."""
    areas = [common_area(task, item) for item in registrations]
    if not all(area.is_empty for area in areas):
        return
    item, area = registrations[0], areas[0]
    needed = 2 * REACH + task.settings.window_taps_px
    rows, columns = (max(size + needed - 1, 0) for size in (area.bottom - area.top, area.right - area.left))
    message = f"images registered by {item.disparity} px per step"
    if item.flow != (0, 0):
        message += f" and {item.flow} px per frame"
    message += f" share only {rows} rows and {columns} columns; filters and window require {needed}"
    raise EstimateError([Problem("estimate.working_point_px", message)])


def shift_by_subpixels(task: EstimationInputs, disparity: int) -> NDArray[Any]:
    """Shift images by the subpixel remainder of a registration disparity (px per step) with quintic splines.

    Returns: Images, shape (channel, s, t, y, x): as recorded if no camera requires a shift, else float32.
    """
    part = _subpixel_parts(task.rig, disparity)
    if np.all(np.abs(part) < _WHOLE):
        return task.images
    images = task.images.astype(np.float32)
    for s in np.flatnonzero(np.abs(part) >= _WHOLE):
        values = images[:, s].astype(np.float64)
        invalid = np.isnan(values)
        if invalid.any():
            values = _filled_along_rows(values, invalid)
        spline = spline_filter1d(values, order=5, axis=-1, mode="mirror")
        images[:, s] = correlate1d(spline, _quintic(part[s]), axis=-1, mode="mirror")
        if invalid.any():
            near = maximum_filter1d(invalid.view(np.uint8), 2 * _SPLINE_REACH_PX + 1, axis=-1, mode="constant")
            images[:, s][near > 0] = np.nan
    return images


def _subpixel_parts(rig: AcquisitionAxes, disparity: int) -> NDArray[np.float64]:
    """Return the remainder in px of the shift of each camera for a disparity in px per step."""
    return np.asarray(-disparity * rig.positions - columns_of_s(rig, disparity))


def _filled_along_rows(values: NDArray[np.float64], invalid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return images whose invalid pixels have the value of the nearest valid pixel to the left, else to the right."""
    width = values.shape[-1]
    at = np.where(invalid, -1, np.arange(width))
    before = np.maximum.accumulate(at, axis=-1)
    after = np.minimum.accumulate(np.where(invalid, width, at)[..., ::-1], axis=-1)[..., ::-1]
    source = np.where(before >= 0, before, after)
    filled = np.take_along_axis(values, np.minimum(source, width - 1), axis=-1)
    return np.where(source < width, filled, 0.0)


def _quintic(part: float) -> NDArray[np.float64]:
    """Return the weights of the quintic B-spline coefficients at ``part`` px to the right of a sample."""
    distance = np.abs(np.arange(-3, 4) - part)
    edges = np.maximum(np.array([3.0, 2.0, 1.0]) - distance[:, None], 0.0) ** 5
    return np.asarray(edges @ np.array([1.0, -6.0, 15.0]) / 120)

"""Errors of an estimate that a calibration causes: their part of the standard deviations, and their modes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.calibration.measurement_covariance import moving_point_modes, point_modes
from scenetruth.capture.rectification import (
    ideal_principal_point,
    ideal_rotation,
    load_calibration,
    step_factor,
)
from scenetruth.errors import ArgumentError, Problem
from scenetruth.schema import describe_variable, estimate_hash, read_intrinsics
from scenetruth.scoring.common_errors import COMMON_QUANTITIES, CommonField, MeasuredPoints, has_common_part

__all__ = ["add_calibration_errors", "calibration_field", "common_variance"]

Floats = NDArray[np.float64]

_NODES = (6, 5, 3)  # nodes along x, y and Z: polynomials of degree 5, 4 and 2
_LEAST_DEPTH_RANGE = 0.05  # smallest range of the depths of the nodes, relative to their mean
_SAME = 1e-9  # relative difference of intrinsic parameters by rounding
_LEAST_MODE = 1e-4  # modes of smaller displacements, relative to the largest, have no effect


def add_calibration_errors(estimate: xr.Dataset, calibration: RigCalibration | str | Path) -> xr.Dataset:
    """Add the uncertainty of a calibration to the standard deviations of an estimate from rectified images.

    Parameters
    ----------
    estimate
        Estimate from a recording of `scenetruth.capture.import_capture` with this calibration.
    calibration
        The calibration, or its file.

    Returns
    -------
    xarray.Dataset
        The estimate. ``depth_std``, ``velocity_std``, ``slope_std`` and ``growth_rate_std`` contain the errors that the
        calibration causes, and ``depth_std_common``, ``velocity_std_common``, ``slope_std_common`` and
        ``growth_rate_std_common`` state the part that pixels have in common. ``calibration_modes`` holds the
        independent errors of points, from which `scenetruth.capture.region_mean` computes the uncertainty of means and
        differences.

    Raises
    ------
    ArgumentError
        If the estimate contains the errors of a calibration already, has no depth or no standard deviation, or its
        intrinsic parameters are not those of the ideal rig of the calibration.

    See Also
    --------
    scenetruth.capture.region_mean : Mean over a region, or difference of two regions.
    scenetruth.capture.calibration.RigCalibration.point_errors : The same for single points.

    Notes
    -----
    A calibration with errors displaces every point P by a smooth field δ(P): a sum of independent modes. Depth changes
    by its component along Z. A velocity U changes by (U·∇) δ, a slope by the derivatives of δ along the surface, and a
    growth rate by the change of these derivatives along U. Disparity and flow are those of the rectified images.

    Examples
    --------
    >>> import scenetruth as st
    >>> from scenetruth.camera import Camera
    >>> camera = Camera(width=60, height=40, focal_length_px=1000)
    >>> rig = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 1.0})
    >>> recording = st.make_recording(np.zeros((3, 1, 40, 60)), focal_length_px=1000, baseline_mm=5)
    >>> depth, std = np.full((40, 60), 500.0), np.full((40, 60), 0.3)
    >>> estimate = st.make_estimate(depth=depth, depth_std=std, recording=recording)
    >>> found = add_calibration_errors(estimate, rig)

    A relative error of the focal length of 0.001 is one of the depth:

    >>> print(np.round(found.depth_std_common[0, 20, 30].item(), 3), np.round(found.depth_std[0, 20, 30].item(), 3))
    0.5 0.583
    """
    rig = load_calibration(calibration)
    problems = list(_problems(estimate, rig))
    if problems:
        raise ArgumentError(problems, source="add_calibration_errors")
    field = calibration_field(rig, estimate)
    found: dict[str, Any] = dict(field.to_variables())
    for name in COMMON_QUANTITIES:
        if not has_common_part(estimate, name) or f"{name}_std" not in estimate:
            continue
        added = common_variance(estimate, field, name)
        for ending in ("_std", "_std_common"):
            variable = name + ending
            before = estimate[variable].values.astype(np.float64) if variable in estimate else np.zeros(added.shape)
            total = np.sqrt(before**2 + added).astype(np.float32)
            found[variable] = (estimate[name].dims, total, describe_variable("estimate", variable))
    done = estimate.assign(found).assign_coords(field.coordinates())
    if "estimate_hash" in done.attrs:
        done.attrs["estimate_hash"] = estimate_hash(done)
    return done


def _problems(estimate: xr.Dataset, rig: RigCalibration) -> Iterator[Problem]:
    """Yield why the errors of a calibration cannot be added to an estimate."""
    lacking = [name for name in ("depth", "depth_std") if name not in estimate]
    if lacking:
        yield Problem("estimate", f"must have {' and '.join(lacking)}", sorted(map(str, estimate.data_vars)))
        return
    if "calibration_modes" in estimate:
        yield Problem("estimate", "contains the errors of a calibration already")
    given, remedy = read_intrinsics(estimate), "use the calibration that has rectified the images"
    step, offset = _pixels_of(estimate, rig)
    focal = rig.value("f") / step
    if step not in (1, 2) or abs(given.focal_length_px / focal - 1) > _SAME:
        message = f"is {given.focal_length_px:.9g} px, but {focal:.9g} px in the calibration"
        yield Problem("focal_length_px", f"{message}: {remedy}")
        return
    if (np.abs(offset - np.rint(offset)) > _SAME * focal).any() or not np.isin(np.rint(offset), range(step)).all():
        point = (np.array(ideal_principal_point(rig)) / step).tolist()
        message = f"is {list(given.principal_point_px)} px, but {point} px in the calibration"
        yield Problem("principal_point_px", f"{message}: {remedy}")
    steps = step_factor(rig) * np.diff(rig.positions_mm)
    low, high = (float(end) for end in (steps.min(), steps.max()))
    if not low - _SAME * abs(low) <= given.baseline_mm <= high + _SAME * abs(high):
        message = f"is {given.baseline_mm:.9g} mm, but the steps of the calibration are {low:.9g} to {high:.9g} mm"
        yield Problem("baseline_mm", f"{message}: {remedy}")


def _pixels_of(estimate: xr.Dataset, rig: RigCalibration) -> tuple[int, Floats]:
    """Return the spacing in px of the camera of the pixels to which the intrinsics refer, and the first of them."""
    given = read_intrinsics(estimate)
    step = round(rig.value("f") / given.focal_length_px)
    return step, np.array(ideal_principal_point(rig)) - step * np.array(given.principal_point_px)


def calibration_field(rig: RigCalibration, estimate: xr.Dataset) -> CommonField:
    """Return the field of a calibration over the pixels and depths of an estimate."""
    given = read_intrinsics(estimate)
    c_x, c_y = given.principal_point_px
    x, y = (
        _chebyshev(float(estimate[dim][0]), float(estimate[dim][-1]), n) for dim, n in zip("xy", _NODES, strict=False)
    )
    depth = estimate["depth"].values
    middle = float(np.median(depth[np.isfinite(depth)])) if np.isfinite(depth).any() else 1.0
    usual = depth[np.isfinite(depth) & (depth > middle / 2) & (depth < 2 * middle)]
    low, high = (float(usual.min()), float(usual.max())) if usual.size else (middle, middle)
    least = _LEAST_DEPTH_RANGE * middle
    if high - low < least:
        low, high = (low + high - least) / 2, (low + high + least) / 2
    nodes = (x - c_x) / given.focal_length_px, (y - c_y) / given.focal_length_px, _chebyshev(low, high, _NODES[2])
    depths, down, across = np.meshgrid(*nodes[::-1], indexing="ij")
    points = np.stack([across * depths, down * depths, depths], axis=-1).reshape(-1, 3)
    turn = ideal_rotation(rig)
    given_rig = (rig.values, rig.covariance, rig.layout, rig.positions_mm, rig.reference, points @ turn.T)
    visits, rates = _measured_visits(rig, estimate), None
    if visits is None:
        modes = point_modes(*given_rig)
    else:
        modes, rates = moving_point_modes(*given_rig, visits)
    kept = np.zeros(len(modes), dtype=np.bool_)
    for part in (modes, rates):
        if part is not None:
            sizes = np.sqrt(np.mean(part**2, axis=(1, 2)))
            kept |= sizes > _LEAST_MODE * sizes.max(initial=0.0)

    def at_nodes(values: Floats) -> Floats:
        # From the frame of the reference camera to that of the ideal rig.
        return np.asarray((values[kept] @ turn).reshape(-1, *depths.shape, 3).transpose(0, 4, 1, 2, 3))

    return CommonField(at_nodes(modes), nodes, (x, y), None if rates is None else at_nodes(rates))


def _measured_visits(rig: RigCalibration, estimate: xr.Dataset) -> NDArray[np.int64] | None:
    """Return the visits of the frames of a fit, as indices in the layout, shape (S, T), if a strip has shown them.

    A fit has as many frames as its setting ``window_frames`` says, or all; fits of other frames have errors alike.
    """
    listed = np.array(rig.measured_visits, dtype=np.int64)
    if listed.size == 0 or tuple(listed.ravel().tolist()) != rig.visits or listed.shape[1] < 2:
        return None
    try:
        window = json.loads(estimate.attrs.get("settings", "{}")).get("window_frames")
    except (TypeError, ValueError, AttributeError):
        window = None
    frames = listed.shape[1]
    size = min(frames, max(2, window)) if isinstance(window, int) else frames
    first = (frames - size) // 2
    return np.arange(listed.size).reshape(listed.shape)[:, first : first + size]


def _chebyshev(low: float, high: float, count: int) -> Floats:
    """Return the extrema of a Chebyshev polynomial, with the ends of the range."""
    places = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray((low + high + places * (high - low)) / 2)


def common_variance(estimate: xr.Dataset, field: CommonField, name: str) -> Floats:
    """Return the variance of a quantity by the modes of a calibration, of the shape of its map; NaN where invalid."""
    shape = estimate[name].shape
    found = np.full(shape, np.nan)
    for t in range(estimate.sizes["t"]):
        where = np.isfinite(estimate["depth"].isel(t=t).values)
        if name != "depth":
            values = estimate[name].isel(t=t).values
            where &= np.isfinite(values if values.ndim == 2 else values.all(axis=0))
        points = MeasuredPoints.from_estimate(estimate, t, where)
        variance = np.empty((*shape[:-3], len(points.depth)))
        for some in points.slices():
            variance[..., some] = np.square(field.errors(name, points.part(some))).sum(axis=0).reshape(*shape[:-3], -1)
        rows, columns = np.nonzero(where)
        found[..., t, rows, columns] = variance
    return found

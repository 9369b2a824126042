"""Means of an estimate over regions, and differences of regions, with their standard deviations."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import ArgumentError, Problem
from scenetruth.number_format import format_two_digits, format_with_std
from scenetruth.scoring.common_errors import COMMON_QUANTITIES, CommonField, MeasuredPoints, has_common_part

__all__ = ["RegionMean", "region_mean"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RegionMean:
    """Mean over a region, or difference of the means over two regions.

    Attributes
    ----------
    value
        The mean, or the difference.
    std
        Its standard deviation: ``std_pixel`` and ``std_common``.
    std_pixel
        Part due to the errors of pixels, which are independent beyond the windows of the method.
    std_common
        Part due to the errors that pixels have in common.
    units
        Units of all values.
    count
        Number of pixels of each region.

    See Also
    --------
    region_mean : Computes it.

    Examples
    --------
    >>> mean = RegionMean(601.24, 0.087, 0.012, 0.086, "mm", (2400,))
    >>> print(mean)
    601.240 ± 0.087 mm (in common: 0.086)
    """

    value: float
    std: float
    std_pixel: float
    std_common: float
    units: str
    count: tuple[int, ...]

    def __str__(self) -> str:
        return f"{format_with_std(self.value, self.std)} {self.units} (in common: {format_two_digits(self.std_common)})"


def region_mean(
    estimate: xr.Dataset,
    quantity: str,
    region: ArrayLike | xr.DataArray,
    *,
    minus: ArrayLike | xr.DataArray | None = None,
    component: str | None = None,
    t: int = 0,
    correlation_px: float | None = None,
) -> RegionMean:
    """Return the mean of a quantity over a region, or the difference of two regions, with its standard deviation.

    Errors that pixels have in common do not average out over a region, and cancel from a difference as far as they are
    the same in both regions.

    Parameters
    ----------
    estimate
        Estimate with standard deviations; with `scenetruth.capture.add_calibration_errors`, those of a calibration.
    quantity
        ``depth`` (mm), ``velocity`` (mm per frame), ``slope``, or ``growth_rate`` (per frame).
    region
        Pixels of the region, boolean, shape (y, x). Pixels that are not valid are omitted.
    minus
        Pixels of a second region, whose mean is subtracted.
    component
        Component of a velocity (``X``, ``Y``, ``Z``) or of a slope (``X``, ``Y``).
    t
        Frame.
    correlation_px
        Standard deviation of the windows of the method in px, over which the errors of pixels are correlated; default:
        the setting ``window_sigma_px`` of the estimate.

    Returns
    -------
    RegionMean
        Value and standard deviations.

    Raises
    ------
    ArgumentError
        If the estimate lacks the quantity or its standard deviation, a region is not valid anywhere, or the windows are
        not stated; lists every problem.

    See Also
    --------
    add_calibration_errors : Adds the errors of a calibration to an estimate.

    Notes
    -----
    The errors of two pixels at the distance r, from Gaussian windows of the standard deviation σ, have the correlation
    exp(-r² / 4σ²). Errors of the pose corrections of the method, which are part of the common errors, are taken as the
    same error of all pixels in units of their standard deviations.

    Examples
    --------
    >>> import scenetruth as st
    >>> from scenetruth.camera import Camera
    >>> from scenetruth.capture import RigCalibration, add_calibration_errors
    >>> recording = st.make_recording(np.zeros((3, 1, 40, 60)), focal_length_px=1000, baseline_mm=5)
    >>> depth, std = np.full((40, 60), 500.0), np.full((40, 60), 0.1)
    >>> depth[:, 30:] = 510.0
    >>> estimate = st.make_estimate(depth=depth, depth_std=std, recording=recording)
    >>> camera = Camera(width=60, height=40, focal_length_px=1000)
    >>> rig = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 1.0})
    >>> found = add_calibration_errors(estimate, rig)
    >>> right = np.arange(60) >= np.full((40, 1), 30)
    >>> print(region_mean(found, "depth", right, correlation_px=3))
    510.00 ± 0.51 mm (in common: 0.51)
    >>> print(region_mean(found, "depth", right, minus=~right, correlation_px=3))
    10.000 ± 0.039 mm (in common: 0.01)
    """
    problems: list[Problem] = []
    lacking = [name for name in (quantity, f"{quantity}_std") if name not in estimate]
    if quantity not in COMMON_QUANTITIES:
        problems.append(Problem("quantity", f"must be one of {', '.join(COMMON_QUANTITIES)}", quantity))
    elif lacking:
        problems.append(Problem("estimate", f"must have {' and '.join(lacking)}", sorted(map(str, estimate.data_vars))))
    frames = estimate["t"].values.tolist()
    if t not in frames:
        problems.append(Problem("t", f"must be one of the frames {frames}", t))
    sigma = _window_px(estimate) if correlation_px is None else correlation_px
    if sigma is None:
        message = "is missing, and the estimate states no window_sigma_px: give the standard deviation of the windows"
        problems.append(Problem("correlation_px", message))
    elif not sigma >= 0:
        problems.append(Problem("correlation_px", "must not be negative", correlation_px))
    number = None if problems else _component(estimate[quantity], component, problems)
    if problems or sigma is None:
        raise ArgumentError(problems, source="region_mean")
    now = estimate.isel(t=[frames.index(t)])
    own = _Selected(now, quantity, number)
    weights, counts = np.zeros(own.values.shape), []
    for name, given, sign in (("region", region, 1.0), ("minus", minus, -1.0)):
        if given is not None:
            chosen = own.pixels(name, given, problems)
            counts.append(int(chosen.sum()))
            weights += sign * chosen / max(counts[-1], 1)
    if problems:
        raise ArgumentError(problems, source="region_mean")
    used = weights != 0
    value = float((weights[used] * own.values[used]).sum())
    common = own.common_std(weights)
    pixel = _correlated_std(np.where(used, weights * np.nan_to_num(own.pixel_std), 0.0), sigma)
    units = str(estimate[quantity].attrs.get("units", ""))
    return RegionMean(value, float(np.hypot(pixel, common)), pixel, common, units, tuple(counts))


class _Selected:
    """One component of a quantity in one frame."""

    def __init__(self, now: xr.Dataset, quantity: str, number: int | None) -> None:
        self._now, self._quantity, self._number = now, quantity, number
        self.values = self._map(quantity)
        std = self._map(f"{quantity}_std")
        common = f"{quantity}_std_common"
        self._common = self._map(common) if common in now else np.zeros_like(std)
        self.pixel_std = np.sqrt(np.maximum(std**2 - self._common**2, 0.0))
        valid = now["valid"].values[0] if "valid" in now else np.ones(std.shape, dtype=np.bool_)
        self._usable: Mask = valid & np.isfinite(self.values) & np.isfinite(std)

    def _map(self, name: str) -> Floats:
        values = self._now[name].values.astype(np.float64)
        return np.asarray(values[0] if self._number is None else values[self._number, 0])

    def pixels(self, name: str, given: Any, problems: list[Problem]) -> Mask:
        """Return the valid pixels of a region; append a problem if there are none."""
        chosen = np.asarray(given)
        if chosen.dtype != np.bool_ or chosen.shape != self.values.shape:
            message = f"must be boolean, of shape {self.values.shape}"
            problems.append(Problem(name, message, f"{chosen.dtype} {chosen.shape}"))
            return np.zeros(self.values.shape, dtype=np.bool_)
        if not (chosen & self._usable).any():
            problems.append(Problem(name, f"has no pixel with a valid {self._quantity}", int(chosen.sum())))
        return chosen & self._usable

    def common_std(self, weights: Floats) -> float:
        """Return the standard deviation of a weighted sum due to the errors that pixels have in common."""
        field = CommonField.from_estimate(self._now)
        where = weights != 0
        rest, total = self._common[where] ** 2, 0.0
        if field is not None and has_common_part(self._now, self._quantity):
            points, sums = MeasuredPoints.from_estimate(self._now, 0, where), np.zeros(len(field.modes))
            for some in points.slices():
                errors = field.errors(self._quantity, points.part(some))[:, self._number or 0]
                sums += errors @ weights[where][some]
                rest[some] -= (errors**2).sum(axis=0)
            total = float((sums**2).sum())
        # Poses that the method has corrected.
        others = float(np.sqrt(np.maximum(rest, 0.0)) @ weights[where])
        return float(np.sqrt(total + others**2))


def _component(values: xr.DataArray, component: str | None, problems: list[Problem]) -> int | None:
    """Return the index of a component; None for a map without components."""
    dim = next((str(dim) for dim in values.dims if dim in ("component", "slope_component")), None)
    if dim is None:
        if component is not None:
            problems.append(Problem("component", f"must be omitted: {values.name} has no components", component))
        return None
    names: list[str] = values[dim].values.tolist()
    if component not in names:
        problems.append(Problem("component", f"must be one of {', '.join(names)}", component))
        return None
    return names.index(component)


def _window_px(estimate: xr.Dataset) -> float | None:
    """Return the standard deviation of the windows that an estimate states."""
    try:
        value = json.loads(estimate.attrs.get("settings", "{}")).get("window_sigma_px")
    except (TypeError, ValueError, AttributeError):
        return None
    return float(value) if isinstance(value, int | float) else None


def _correlated_std(parts: Floats, sigma_px: float) -> float:
    """Return the standard deviation of a sum of errors that are correlated by windows; ``parts`` are theirs."""
    from scipy.ndimage import gaussian_filter

    if sigma_px == 0:
        return float(np.sqrt((parts**2).sum()))
    width = np.sqrt(2.0) * sigma_px
    pad = int(np.ceil(4 * width))
    padded = np.pad(parts, pad)
    smooth = gaussian_filter(padded, width, mode="constant", truncate=4.0)
    # A unit impulse keeps its own variance.
    peak = gaussian_filter(np.pad([[1.0]], pad), width, mode="constant", truncate=4.0)[pad, pad]
    return float(np.sqrt(max(float((padded * smooth).sum() / peak), 0.0)))

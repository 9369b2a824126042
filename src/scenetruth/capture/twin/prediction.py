"""Errors that a twin predicts for a measurement, by region, with the values that both show without a truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from scenetruth.errors import Problem
from scenetruth.number_format import format_number, format_percent_value
from scenetruth.output import write_atomically
from scenetruth.results import QuantityValue, Result, refuse_unknown
from scenetruth.schema import STATUS_VALID
from scenetruth.scoring import QUANTITIES, Quantity, Score
from scenetruth.scoring.quantities import get_title
from scenetruth.scoring.regions import edge_distance, further_regions, main_regions, title_region, visible_throughout
from scenetruth.scoring.scorer import local_contrast, reference_images
from scenetruth.settings import ScoreSettings

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Comparison",
    "RegionError",
    "TwinPrediction",
    "draw_prediction",
    "mark_bends",
    "predict_errors",
    "sampling_std",
]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MAIN = ("depth", "velocity_x", "velocity_y", "velocity_z", "growth_rate")
_EVERYWHERE = ("depth", "velocity_z")
"""Quantities of the summary in the interior, and in other regions."""
_LIKE = (0.8, 1.25)
"""Ratios of capture and twin between which a value is taken to be the same."""
_ERROR_WINDOW_PX = 6.0
_BEND_PX, _BEND_DEG, _BEND_STDS, _CENTRE_PX = 6, 40.0, 3.0, 2
_LEAST_ERRORS, _UNCORRELATED = 64, 0.1


@dataclass(frozen=True)
class RegionError:
    """Predicted error of one quantity in one region.

    ``region``, ``quantity``, ``unit``: As in a score.
    ``count``: Pixels that are valid in the twin and in the measurement; the errors are those of these pixels.
    ``density``: Share of the pixels of the region that are valid in the twin.
    ``pixel_std``: Standard deviation of the errors of the twin about their mean.
    ``bias``: Mean error of the twin.
    ``common_std``: Stated uncertainty that all pixels have in common, of the measurement: calibration, stage and lens.
    ``rmse``: Predicted root-mean-square error of the measurement: the root of the sum of squares of the three.
    ``stated_capture``, ``stated_twin``: Root mean square of the stated standard deviation of a pixel.
    ``capture_density``: Share of the pixels of the region that the measurement has.
    ``sampling_std``: Relative standard deviation of ``pixel_std``, because simulations have few independent errors;
    the errors of the measurement scatter about their expected size as much as those of one simulation.

    See Also
    --------
    TwinPrediction : Contains one for each region and quantity.

    Examples
    --------
    >>> row = RegionError("interior", "depth", "mm", 900, 0.9, 0.03, 0.0, 0.04, 0.05, 0.03, 0.03, 0.9)
    >>> row.rmse
    0.05
    """

    region: str
    quantity: str
    unit: str
    count: int
    density: float
    pixel_std: float
    bias: float
    common_std: float
    rmse: float
    stated_capture: float
    stated_twin: float
    capture_density: float
    sampling_std: float = math.nan


@dataclass(frozen=True)
class Comparison:
    """A value that capture and twin show without a truth.

    See Also
    --------
    TwinPrediction : Contains them.

    Examples
    --------
    >>> residual = Comparison("residual of the fit", "DN", 1.2, 0.8)
    >>> round(residual.ratio, 2), residual.agrees
    (1.5, False)
    """

    name: str
    unit: str
    capture: float
    twin: float

    @property
    def ratio(self) -> float:
        """Value of the capture relative to that of the twin."""
        return self.capture / self.twin if self.twin else math.nan

    @property
    def agrees(self) -> bool | None:
        """Whether the ratio is between 0.8 and 1.25; None if it is undefined."""
        return None if not math.isfinite(self.ratio) else _LIKE[0] <= self.ratio <= _LIKE[1]


@dataclass(frozen=True, repr=False)
class TwinPrediction(Result):
    """Errors to expect from a measurement, from its twin.

    Parameters
    ----------
    rows
        Predicted errors by region and quantity.
    comparisons
        Values that the measurement and its twin both show without a truth.
    notes
        Differences of the twin from the measurement.

    See Also
    --------
    scenetruth.capture.run_twin : Computes it.

    Examples
    --------
    >>> from scenetruth.capture import RegionError, TwinPrediction
    >>> row = RegionError("interior", "depth", "mm", 900, 0.9, 0.03, 0.0, 0.04, 0.05, 0.03, 0.03, 0.9)
    >>> found = TwinPrediction((row,))
    >>> found.value("depth").value, found.value("depth", "pixel_std").unit
    (0.05, 'mm')
    """

    rows: tuple[RegionError, ...]
    comparisons: tuple[Comparison, ...] = ()
    notes: tuple[str, ...] = ()

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "interior") -> QuantityValue:
        """Return a predicted error.

        Parameters
        ----------
        quantity
            Quantity, such as ``depth`` or ``velocity_z``.
        statistic
            ``rmse``, ``pixel_std``, ``bias``, ``common_std``, ``density``, ``capture_density``, ``stated_capture``,
            ``stated_twin`` or ``sampling_std``.
        region
            Region of the image.

        Returns
        -------
        QuantityValue
            The value with its unit.

        Raises
        ------
        ArgumentError
            If there is no such value.
        """
        found = {(row.region, row.quantity): row for row in self.rows}
        statistics = [name for name in RegionError.__dataclass_fields__ if name not in ("region", "quantity", "unit")]
        refuse_unknown(
            quantity=(quantity, sorted({row.quantity for row in self.rows})),
            region=(region, sorted({row.region for row in self.rows})),
            statistic=(statistic, statistics),
        )
        row = found[region, quantity]
        unit = "1" if statistic in ("density", "capture_density", "count", "sampling_std") else row.unit
        return QuantityValue(getattr(row, statistic), unit, statistic=statistic, region=region, n=row.count)

    def to_dataframe(self) -> pd.DataFrame:
        """Return the predicted errors as a table, one row per region and quantity."""
        import pandas as pd

        return pd.DataFrame([vars(row) for row in self.rows], columns=list(RegionError.__dataclass_fields__))

    def summary(self) -> str:
        """Return the main errors, and where capture and twin differ, as text."""
        lines = [self._state_result()] if any(row.count for row in self.rows) else []
        lines += [
            "predicted errors: region, quantity, RMSE = pixel + common + bias (root of the sum of squares), density"
        ]
        for row in self.rows:
            shown = _MAIN if row.region == "interior" else _EVERYWHERE
            if row.quantity not in shown or not row.count:
                continue
            parts = " + ".join(format_number(abs(each)) for each in (row.pixel_std, row.common_std, row.bias))
            name, total = get_title(row.quantity), format_number(row.rmse)
            share = format_percent_value(row.density)
            scatter = ""
            if math.isfinite(row.sampling_std):
                scatter = f"; pixel ± {format_percent_value(row.sampling_std)} %"
            lines.append(
                f"  {title_region(row.region):23} {name:13} {total:>8} {row.unit} = {parts}, {share} %{scatter}"
            )
        if not any(row.count for row in self.rows):
            lines.append("  none: no pixel of the twin has a valid estimate")
        if self.comparisons:
            lines.append("shown by the capture and by its twin:")
        for each in self.comparisons:
            differs = "" if each.agrees is not False else f"; ratio {each.ratio:.2f}"
            values = f"{format_number(each.capture)} and {format_number(each.twin)} {each.unit}".rstrip()
            lines.append(f"  {each.name}: {values}{differs}")
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def _state_result(self) -> str:
        """Return the predicted errors of the interior as a sentence."""
        main = [row for row in self.rows if row.region == "interior" and row.quantity in _EVERYWHERE and row.count]
        if not main:
            return "the interior of the twin has no valid estimate"
        parts = [
            f"{get_title(row.quantity)[0].lower()}{get_title(row.quantity)[1:]} to "
            f"{format_number(row.rmse, 2)} {row.unit}"
            for row in main
        ]
        return f"a twin of this capture measures {' and '.join(parts)} (RMSE in the interior)"

    def __repr__(self) -> str:
        main = [row for row in self.rows if row.region == "interior" and row.quantity in _MAIN]
        errors = ", ".join(f"{row.quantity} {row.rmse:.3g} {row.unit}" for row in main)
        return f"TwinPrediction(RMSE in the interior: {errors})"

    @property
    def disagreements(self) -> list[Problem]:
        """Values of the capture that its twin does not show, within 0.8 to 1.25."""
        return [
            Problem(each.name, f"is {each.ratio:.2f} times that of the twin: its errors may differ", each.capture)
            for each in self.comparisons
            if each.agrees is False
        ]  # fmt: skip


def mark_bends(truth: xr.Dataset, depth_std: Floats | None = None) -> xr.Dataset:
    """Return a truth whose mixed pixels contain strong bends: creases that a method has rounded.

    The normals at 6 px on either side of a bend differ by more than 40°, half of it within 2 px of both
    sides, so that a rounded crease is about as narrow as a sharp one. A bend that the uncertainty of the measured depth
    explains is none: its second difference over 6 px is below three standard deviations.

    ``depth_std``: Standard deviation of the depth from which the surface was made, shape (y, x), NaN where it has none;
    default: exact.
    """
    depth = truth["depth"].transpose("t", "y", "x").values.astype(np.float64)
    normal = truth["normal"].transpose("t", "y", "x", "component").values
    bent = np.zeros(normal.shape[:-1], dtype=np.bool_)
    least = np.zeros(bent.shape[1:]) if depth_std is None else _BEND_STDS * np.nan_to_num(depth_std, nan=np.inf)
    for axis in (1, 2):
        one, other = (np.roll(normal, shift, axis=axis) for shift in (_BEND_PX, -_BEND_PX))
        far, near = (np.roll(normal, shift, axis=axis) for shift in (_CENTRE_PX, -_CENTRE_PX))
        here, there = (np.roll(depth, shift, axis=axis) for shift in (-_BEND_PX, _BEND_PX))
        inside = np.zeros(bent.shape[axis], dtype=np.bool_)
        inside[_BEND_PX:-_BEND_PX] = True
        shape = [1, 1, 1]
        shape[axis] = -1
        with np.errstate(invalid="ignore"):
            turn, left, right = _angle(one, other), _angle(one, near), _angle(far, other)
            central = np.minimum(left, right) >= 0.5 * turn
            bent |= (turn > _BEND_DEG) & central & (np.abs(here + there - 2 * depth) > least) & inside.reshape(shape)
    mixed = truth["mixed"].values.astype(bool) | bent
    distance = edge_distance(mixed)
    return truth.assign(
        mixed=(truth["mixed"].dims, mixed, truth["mixed"].attrs),
        boundary_distance=(truth["boundary_distance"].dims, distance, truth["boundary_distance"].attrs),
    )


def _angle(one: Floats, other: Floats) -> Floats:
    """Return the angle between unit vectors in degrees."""
    return np.asarray(np.rad2deg(np.arccos(np.clip(np.sum(one * other, axis=-1), -1.0, 1.0))))


def predict_errors(
    score: Score,
    twins: Sequence[xr.Dataset],
    truth: xr.Dataset,
    twin_recording: xr.Dataset,
    capture: xr.Dataset,
    comparisons: tuple[Comparison, ...] = (),
    notes: tuple[str, ...] = (),
) -> TwinPrediction:
    """Return the errors to expect from a measurement, over the pixels that are valid in it and in the twin.

    ``score``: Score of the first estimate of the twin. ``twins``: Estimates of its simulations, which differ in the
    noise. ``truth``, ``twin_recording``: Its truth, and its first recording. ``capture``: Estimate of the measurement.
    """
    settings = ScoreSettings(**score.metadata.get("score_settings", {}))
    frames = np.intersect1d(twins[0]["t"].values, capture["t"].values)
    estimates = [each.sel(t=frames) for each in twins]
    other, exact = (each.sel(t=frames) for each in (capture, truth))
    masks = main_regions(exact, settings.interior_margin_px)
    contrast = local_contrast(reference_images(twin_recording, frames), settings.contrast_window_px)
    masks |= further_regions(
        exact, masks["interior"], settings, throughout=visible_throughout(exact), contrast=contrast
    )  # fmt: skip
    rows = []
    for region, quantities in score.regions.items():
        for name, values in quantities.items():
            if name not in QUANTITIES or "bias" not in values or region not in masks:
                continue
            quantity = QUANTITIES[name]
            shown = masks[region] & _valid(other, quantity.needs)
            found = [_errors(name, shown, each, exact) for each in estimates]
            errors = [each for each in found if each is not None]
            stated = [_pixel_std(each, quantity.variable, quantity.component) for each in estimates[: len(errors)]]
            statistics = _statistics(_unit_factor(quantity, other), errors, stated)
            rows.append(_row(region, name, values, masks[region], estimates[0], other, statistics))
    return TwinPrediction(tuple(rows), comparisons, notes)


@dataclass(frozen=True)
class _ErrorStatistics:
    """Statistics of the errors of all simulations of a twin; ``count`` is that of the first."""

    count: int
    bias: float
    pixel_std: float
    sampling_std: float


def _statistics(scale: float, errors: Sequence[Floats], stated: Sequence[Floats | None]) -> _ErrorStatistics | None:
    """Return the statistics of the errors of all simulations, times ``scale``; None if there are no maps of errors."""
    if not errors:
        return None
    samples = [each[np.isfinite(each)] for each in errors]
    kept = [each for each in samples if each.size]
    if not kept:
        return _ErrorStatistics(0, math.nan, math.nan, math.nan)
    bias = scale * float(np.mean([each.mean() for each in kept]))
    pixel = scale * math.sqrt(float(np.mean([each.var() for each in kept])))
    scatter = [sampling_std(each, std) for each, std in zip(errors, stated, strict=True)]
    # Simulations are independent.
    sampling = math.sqrt(float(np.mean(np.square(scatter))) / len(kept))
    return _ErrorStatistics(samples[0].size, bias, pixel, sampling)


def _row(
    region: str,
    name: str,
    values: Any,
    mask: Mask,
    twin: xr.Dataset,
    capture: xr.Dataset,
    errors: _ErrorStatistics | None,
) -> RegionError:
    quantity = QUANTITIES[name]
    if errors is None:
        bias, rmse = (math.nan if values[each] is None else float(values[each]) for each in ("bias", "rmse"))
        pixel = math.sqrt(max(rmse**2 - bias**2, 0.0)) if math.isfinite(rmse) else math.nan
        errors = _ErrorStatistics(int(values.get("count") or 0), bias, pixel, math.nan)
    scale = _unit_factor(quantity, twin)
    common = scale * _rms(_map(capture, f"{quantity.variable}_std_common", quantity.component), mask)
    common = common if math.isfinite(common) else 0.0
    valid = _valid(capture, quantity.needs)
    share = float((valid & mask).sum() / mask.sum()) if mask.any() else math.nan
    return RegionError(
        region,
        name,
        quantity.units,
        errors.count,
        float(values.get("density") or 0.0),
        errors.pixel_std,
        errors.bias,
        common,
        math.sqrt(errors.pixel_std**2 + errors.bias**2 + common**2),
        scale * _rms(_pixel_std(capture, quantity.variable, quantity.component), mask & valid),
        scale * _rms(_pixel_std(twin, quantity.variable, quantity.component), mask & _valid(twin, quantity.needs)),
        share,
        errors.sampling_std,
    )


def _errors(name: str, mask: Mask, twin: xr.Dataset, truth: xr.Dataset) -> Floats | None:
    """Return the errors of a quantity in a region, shape (t, y, x), NaN elsewhere; None if they are no differences."""
    quantity = QUANTITIES[name]
    if quantity.error != "difference":
        return None
    found, exact = (_map(each, quantity.variable, quantity.component) for each in (twin, truth))
    if found is None or exact is None or found.shape != mask.shape or exact.shape != mask.shape:
        return None
    return np.where(mask & _valid(twin, quantity.needs), found - exact, np.nan)


def sampling_std(errors: Floats, std: Floats | None = None) -> float:
    """Return the relative standard deviation of the standard deviation of correlated errors.

    The mean square of errors with the variances v has the relative variance 2 Σ ρ² v v' / (Σ v)², over all pairs of
    pixels with the correlation ρ, and its root a quarter of that. ρ is the autocorrelation of the errors over their
    standard deviations, averaged over directions and up to the distance at which it falls below 0.1. Errors of
    different frames, which share their images, count as one.

    ``errors``: Errors, shape (t, y, x), NaN where there is none. ``std``: Their standard deviations; default: equal.
    """
    inside = np.isfinite(errors)
    if inside.sum() < _LEAST_ERRORS:
        return math.nan
    deviation = np.ones(errors.shape)
    if std is not None:
        given = inside & np.isfinite(std) & (std > 0)
        typical = float(np.median(std[given])) if given.any() else 1.0
        # Errors over deviations that are far too small would dominate the correlation.
        deviation = np.where(given, np.maximum(std, 0.3 * typical), typical)
    centred = np.where(inside, (errors - errors[inside].mean()) / deviation, 0.0)
    variance = np.where(inside, deviation**2, 0.0)
    shape = [fft.next_fast_len(2 * size, real=True) for size in errors.shape[1:]]
    known = inside.astype(np.float64)
    products, pairs, squares = (_autocorrelation(each, shape) for each in (centred, known, variance))
    if not products[0, 0] > 0:
        return math.nan
    y, x = (np.minimum(np.arange(size), size - np.arange(size)) for size in shape)
    distance = np.rint(np.hypot(y[:, None], x)).astype(np.int64).ravel()
    product, pair, square = (np.bincount(distance, each.ravel()) for each in (products, pairs, squares))
    rho = (product / np.maximum(pair, 1.0)) / (product[0] / pair[0])
    below = np.flatnonzero((rho < _UNCORRELATED) | (pair < pair[0]))
    end = int(below[0]) if below.size else len(rho)
    share = float(np.sum(rho[:end] ** 2 * square[:end])) / float(variance.sum()) ** 2
    return math.sqrt(0.5 * len(errors) * share)


def _autocorrelation(values: Floats, shape: list[int]) -> Floats:
    """Return the sum over frames of the products of values at a distance, shape ``shape``."""
    return np.asarray(fft.irfft2((np.abs(fft.rfft2(values, shape)) ** 2).sum(axis=0), shape))


def _unit_factor(quantity: Quantity, dataset: xr.Dataset) -> float:
    """Return the factor from the unit of a stored variable to that of its errors."""
    if quantity.units == "%/h" and quantity.variable in dataset:
        return 100 * 3600 / float(dataset.attrs["frame_interval_s"])
    return 1.0


def _map(dataset: xr.Dataset, name: str, component: int | None) -> Floats | None:
    if not name or name not in dataset:
        return None
    values = dataset[name].values.astype(np.float64)
    if values.ndim == 4 and component is None:
        return None
    return np.asarray(values if component is None else values[component])


def _rms(values: Floats | None, mask: Mask) -> float:
    if values is None or values.shape != mask.shape:
        return math.nan
    inside = values[mask & np.isfinite(values)]
    return float(np.sqrt(np.mean(inside**2))) if inside.size else math.nan


def _pixel_std(dataset: xr.Dataset, variable: str, component: int | None) -> Floats | None:
    """Return the stated deviation of a pixel, without the common part; None if there is none."""
    total, common = (_map(dataset, f"{variable}_{part}", component) for part in ("std", "std_common"))
    if total is None or common is None:
        return total
    return np.sqrt(np.maximum(total**2 - np.nan_to_num(common) ** 2, 0.0))


def _valid(dataset: xr.Dataset, needs: tuple[str, ...]) -> Mask:
    """Return where a quantity is valid, shape (t, y, x)."""
    found = np.isfinite(dataset["depth"].values)
    for need in needs:
        if f"status_{need}" in dataset:
            found &= dataset[f"status_{need}"].values == STATUS_VALID
    return np.asarray(found)


def compare_estimates(capture: xr.Dataset, twin: xr.Dataset, scales: tuple[float, float]) -> Iterator[Comparison]:
    """Yield values that two estimates show without a truth.

    ``scales``: Full scale of both recordings.
    """
    both = _valid(capture, ("disparity",)) & _valid(twin, ("disparity",))
    share = [100 * float(_valid(each, ("disparity",)).mean()) for each in (capture, twin)]
    yield Comparison("pixels with a valid depth", "%", *share)
    if "residual" in capture and "residual" in twin:
        values = [
            100 * _median(each["residual"].values, both) / scale
            for each, scale in zip((capture, twin), scales, strict=True)
        ]  # fmt: skip
        yield Comparison("residual of the fit, median", "% of full scale", *values)
    for name, unit in (("depth", "mm"), ("velocity", "mm/frame")):
        for component, label in (
            [(None, "depth")] if name == "depth" else [(0, "U_X"), (1, "U_Y"), (2, "U_Z")]
        ):  # fmt: skip
            if f"{name}_std" in capture and f"{name}_std" in twin:
                stated = [_rms(_pixel_std(each, name, component), both) for each in (capture, twin)]
                yield Comparison(f"stated standard deviation of {label}, RMS", unit, *stated)
    loops = [_closure(each) for each in (capture, twin)]
    if all(map(math.isfinite, loops)):
        yield Comparison("depth change less U_Z between frames, robust std", "mm", *loops)


def _median(values: NDArray[np.floating], mask: Mask) -> float:
    inside = values[mask & np.isfinite(values)]
    return float(np.median(inside)) if inside.size else math.nan


def _closure(estimate: xr.Dataset) -> float:
    """Return the robust deviation of the change of depth along the motion from U_Z, over consecutive frames."""
    frames = estimate["t"].values
    if "velocity" not in estimate or "flow" not in estimate or len(frames) < 2:
        return math.nan
    valid, found = _valid(estimate, ("disparity", "motion")), []
    for first in range(len(frames) - 1):
        if frames[first + 1] != frames[first] + 1:
            continue
        here, there = (estimate.isel(t=number) for number in (first, first + 1))
        y, x = np.indices(here["depth"].shape)
        u, v = here["flow"].values.astype(np.float64)
        place = np.stack([y + np.nan_to_num(v), x + np.nan_to_num(u)])
        depth, rate = (
            ndimage.map_coordinates(np.where(valid[first + 1], each, np.nan), place, order=1, cval=np.nan)
            for each in (there["depth"].values.astype(np.float64), there["velocity"].values[2].astype(np.float64))
        )
        mean_rate = 0.5 * (rate + here["velocity"].values[2])
        gap = depth - here["depth"].values - mean_rate
        found.append(gap[valid[first] & np.isfinite(gap)])
    gaps = np.concatenate(found) if found else np.empty(0)
    return 1.4826 * float(np.median(np.abs(gaps))) if gaps.size else math.nan


def draw_prediction(
    file: Path, capture: tuple[xr.Dataset, xr.Dataset], twin: tuple[xr.Dataset, xr.Dataset], truth: xr.Dataset
) -> None:
    """Write a picture: reference images, depth, stated and predicted error of depth.

    ``capture``, ``twin``: Recording and estimate.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    images = [reference_images(recording, np.array([0]))[0] for recording, _ in (capture, twin)]
    depths = [each["depth"].sel(t=0).values.astype(np.float64) for _, each in (capture, twin)]
    error = depths[1] - truth["depth"].sel(t=0).values
    known = np.isfinite(error) & _valid(twin[1].sel(t=[0]), ("disparity",))[0]
    weight = ndimage.gaussian_filter(known.astype(np.float64), _ERROR_WINDOW_PX)
    square = ndimage.gaussian_filter(np.where(known, error**2, 0.0), _ERROR_WINDOW_PX)
    predicted = np.where(known, np.sqrt(square / np.maximum(weight, 1e-12)), np.nan)
    stated = np.full(predicted.shape, np.nan)
    if "depth_std" in capture[1]:
        common = capture[1].get("depth_std_common")
        total = capture[1]["depth_std"].sel(t=0).values.astype(np.float64)
        apart = 0.0 if common is None else common.sel(t=0).values.astype(np.float64)
        stated = np.sqrt(np.maximum(total**2 - apart**2, 0.0))
    finite = [each[np.isfinite(each)] for each in (predicted, stated)]
    highest = max((float(np.percentile(each, 95)) for each in finite if each.size), default=1.0)
    near, far = np.nanpercentile(depths[0], (1, 99)) if np.isfinite(depths[0]).any() else (0.0, 1.0)
    panels = (
        ("capture: reference image", images[0], "gray", (0.0, max(float(np.nanmax(images[0])), 1e-6)), "full scale"),
        ("twin: reference image", images[1], "gray", (0.0, max(float(np.nanmax(images[0])), 1e-6)), "full scale"),
        ("capture: depth", depths[0], "viridis", (near, far), "mm"),
        ("twin: depth", depths[1], "viridis", (near, far), "mm"),
        ("capture: stated standard deviation of a pixel", stated, "magma", (0.0, highest), "mm"),
        ("twin: RMS error of depth (window 6 px)", predicted, "magma", (0.0, highest), "mm"),
    )
    ratio = images[0].shape[0] / images[0].shape[1]
    figure = Figure(figsize=(9.0, 3 * (4.0 * ratio + 0.5)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axis, (title, values, colours, limits, unit) in zip(figure.subplots(3, 2).ravel(), panels, strict=True):
        drawn = axis.imshow(values, cmap=colours, vmin=limits[0], vmax=limits[1], interpolation="nearest")
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
        figure.colorbar(drawn, ax=axis, label=unit, shrink=0.85)
    with write_atomically(file, overwrite=True) as partial:
        figure.savefig(partial, format="png", metadata={"Software": "scenetruth"})

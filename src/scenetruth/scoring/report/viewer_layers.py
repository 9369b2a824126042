"""The maps of one frame for the viewer, their display ranges, and the positions of the largest errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import STATUS_FALLBACK, STATUS_INVALID, STATUS_NORMAL, STATUS_VALID, read_intrinsics
from scenetruth.scoring.error_pairs import (
    find_valid_pixels,
    has_quantity,
    list_quantities,
    percent_per_hour,
    read_quantity,
    read_std,
)
from scenetruth.scoring.growth_rate import compute_growth_maps, compute_growth_rate
from scenetruth.scoring.quantities import ENDPOINT, QUANTITIES
from scenetruth.scoring.statistics import angle_deg
from scenetruth.settings import ScoreSettings

__all__ = [
    "FALLBACK",
    "ErrorHotspot",
    "ViewerLayers",
    "build_layers",
    "choose_scale",
    "collect_error_maps",
    "compute_display_ranges",
    "find_error_hotspots",
    "value_limits",
]


Map = NDArray[np.float64]

_MAIN = ("depth", "disparity", "velocity", "flow", "growth", "windowed growth")
"""Groups of quantities with priority if the space is limited."""
_STATUSES = {
    STATUS_INVALID: "invalid",
    STATUS_NORMAL: "normal component only",
    STATUS_VALID: "valid",
    STATUS_FALLBACK: "fallback",
}
FALLBACK = "fallback_"
"""Prefix of the names of packed maps of fallback values."""
_MAP_DIMS = ("t", "y", "x")
_INVALID = ("face_id", "mixed", "depth", "disparity", "growth_rate", "boundary_distance")
"""Variables of a truth that are shown otherwise or whose values carry no information for readers."""


@dataclass(frozen=True)
class ViewerLayers:
    """The maps of one quantity in one frame; ``main``: whether it has priority if the space is limited.

    ``maps``: ``estimate``, ``truth``, ``error`` and ``std`` of a quantity, or ``value`` of other variables; float64, or
      integers for codes, shape (y, x), NaN where undefined.
    ``fallback``: ``estimate``, ``error`` and ``std`` of fallback values, NaN elsewhere; empty if there are none or they
      count as valid.
    """

    name: str
    title: str
    symbol: str
    units: str
    main: bool
    maps: Mapping[str, NDArray[Any]]
    codes: Mapping[int, str] = field(default_factory=dict)
    fallback: Mapping[str, Map] = field(default_factory=dict)


def build_layers(
    estimate: xr.Dataset, truth: xr.Dataset | None, settings: ScoreSettings, *, grows: bool, step: int
) -> Iterator[ViewerLayers]:
    """Yield the maps of one frame, the most informative first; the estimate is NaN where invalid, as in the score."""
    names = _list_shown(estimate, truth, grows=grows)
    # Valid pixels are determined once for each variable, not for each component.
    known: dict[str, NDArray[np.bool_]] = {}
    fallback = settings.include_fallback
    for name in sorted(names, key=lambda name: QUANTITIES[name].group not in _MAIN):
        entry = QUANTITIES[name]
        maps: dict[str, Map] = {}
        has = entry.variable in estimate
        if has and entry.variable not in known:
            known[entry.variable] = thinned(
                find_valid_pixels(estimate, entry.variable, include_fallback=fallback), step
            )
        entries = truth is not None and has_quantity(truth, name)
        if entry.error == "difference":
            if has:
                maps["estimate"] = np.where(known[entry.variable], thinned(read_quantity(estimate, name), step), np.nan)
            if entries and truth is not None:
                maps["truth"] = thinned(read_quantity(truth, name), step)
            if len(maps) == 2:
                maps["error"] = maps["estimate"] - maps["truth"]
        elif has and entries and truth is not None and entry.error != "distance":
            angle = angle_deg(
                read_quantity(estimate, name), read_quantity(truth, name), lines=entry.error == "axis_angle"
            )
            maps["error"] = np.where(known[entry.variable], thinned(angle, step), np.nan)
        std = read_std(estimate, name) if maps and has else None
        if std is not None:
            maps["std"] = np.where(known[entry.variable], thinned(std, step), np.nan)
        if any(np.isfinite(values).any() for values in maps.values()):
            extra = {} if fallback else _fallback_maps(estimate, name, maps, known.get(entry.variable), step)
            main = entry.group in _MAIN
            yield ViewerLayers(name, entry.title, entry.symbol, entry.units, main, maps, fallback=extra)
    if "growth_rate" not in estimate and grows:
        yield from _windowed(estimate, truth, settings, step)
    yield from _further(estimate, truth, step)


def _fallback_maps(
    estimate: xr.Dataset, name: str, maps: Mapping[str, Map], valid: NDArray[np.bool_] | None, step: int
) -> dict[str, Map]:
    """Return the maps of a quantity at its fallback values, NaN elsewhere; empty without any."""
    if valid is None or "estimate" not in maps:
        return {}
    where = thinned(find_valid_pixels(estimate, QUANTITIES[name].variable, include_fallback=True), step) & ~valid
    where &= np.isfinite(thinned(read_quantity(estimate, name), step))
    if not where.any():
        return {}
    found = {"estimate": np.where(where, thinned(read_quantity(estimate, name), step), np.nan)}
    if "truth" in maps:
        found["error"] = found["estimate"] - maps["truth"]
    std = read_std(estimate, name)
    if std is not None:
        found["std"] = np.where(where, thinned(std, step), np.nan)
    return found


def thinned(values: NDArray[Any], step: int) -> NDArray[Any]:
    """Return every ``step``-th row and column of a single-frame map, shape (1, y, x)."""
    return values[0, ::step, ::step]


def _list_shown(estimate: xr.Dataset, truth: xr.Dataset | None, *, grows: bool) -> list[str]:
    """Return the keys of `QUANTITIES` that estimate or truth contain."""
    of_estimate = list_quantities(estimate)
    names = []
    for name, entry in QUANTITIES.items():
        if not entry.variable or (entry.is_growth and not grows) or entry.error == "distance":
            continue
        entries = truth is not None and has_quantity(truth, name)
        if name in of_estimate or (entries and (entry.error == "difference" or entry.variable in estimate)):
            names.append(name)
    return names


def _windowed(
    estimate: xr.Dataset, truth: xr.Dataset | None, settings: ScoreSettings, step: int
) -> Iterator[ViewerLayers]:
    """Yield the growth rate computed from depth and velocity in windows."""
    if not {"depth", "velocity"} <= set(estimate):
        return
    factor = percent_per_hour(read_intrinsics(estimate))
    entry = QUANTITIES["growth_rate_windowed"]
    if truth is None:
        maps = {"estimate": factor * thinned(compute_growth_rate(estimate, settings=settings).values, step)}
    else:
        found = compute_growth_maps(estimate, truth, settings)
        if found is None:
            return
        maps = {
            "estimate": factor * thinned(found.estimate, step),
            "truth": factor * thinned(found.truth_windowed, step),
        }
        maps["error"] = maps["estimate"] - maps["truth"]
    if np.isfinite(maps["estimate"]).any():
        yield ViewerLayers("growth_rate_windowed", entry.title, entry.symbol, entry.units, True, maps)


def _further(estimate: xr.Dataset, truth: xr.Dataset | None, step: int) -> Iterator[ViewerLayers]:
    """Yield variables without errors: quality measures of the method, and further maps of the truth."""
    compared = {entry.variable for entry in QUANTITIES.values()}
    stated = {f"{variable}_std" for variable in compared}
    parts = (("estimate", estimate, compared | stated), ("truth", truth, {*compared, *_INVALID}))
    for origin, part, entries in parts:
        for name in () if part is None else map(str, part.data_vars):
            if part is None or name in entries or part[name].dims != _MAP_DIMS:
                continue
            values = thinned(part[name].values, step)
            if values.dtype.kind not in "iubf":
                continue
            words = name.replace("_", " ").capitalize()
            title = words if origin == "estimate" else f"{words} (truth)"
            flags = values.dtype.kind in "iub" or name.startswith("status") or name in ("valid", "invalid_reason")
            if flags and values.dtype.kind == "f":
                values = np.nan_to_num(values).astype(np.int64)
            codes = _codes(part[name]) if flags else {}
            if name.startswith("status"):
                codes = _STATUSES
            units = str(part[name].attrs.get("units", "1"))
            yield ViewerLayers(f"{origin}.{name}", title, "", units, False, {"value": values}, codes)


def _codes(variable: xr.DataArray) -> dict[int, str]:
    """Return the meanings of the values of a variable from its flag attributes."""
    if variable.dtype.kind == "b":
        return {0: "no", 1: "yes"}
    numbers, words = variable.attrs.get("flag_values"), variable.attrs.get("flag_meanings")
    if numbers is None or not isinstance(words, str):
        return {}
    meant = [word.replace("_", " ") for word in words.split()]
    return {int(number): word for number, word in zip(np.atleast_1d(numbers), meant, strict=False)}


Limits = tuple[float, float]

_EVERY = 40_000
"""Approximate number of values from which display ranges are computed."""


def choose_scale(what: str) -> str:
    """Return the name of the display range of a map; estimate and truth share one, as do fallback values."""
    what = what.removeprefix(FALLBACK)
    return what if what in ("error", "std") else "value"


def compute_display_ranges(layers: ViewerLayers) -> dict[str, Limits]:
    """Return the display ranges of the maps of a quantity, by the names of `choose_scale`."""
    maps = layers.maps
    limits = {}
    values = [maps[what].astype(np.float64) for what in ("estimate", "truth", "value") if what in maps]
    if values:
        limits["value"] = value_limits(*values)
    if layers.codes:
        limits["value"] = (float(min(layers.codes)), float(max(layers.codes)))
    elif layers.name.endswith(".coherence"):
        limits["value"] = (0.0, 1.0)
    if layers.name.startswith("growth") and "truth" in maps:
        # The truth must remain visible for noisy estimates.
        low, high = limits["value"]
        grows = float(np.nanmax(np.abs(maps["truth"]), initial=0.0))
        if grows > 1e-9 * max(abs(low), abs(high)):
            limits["value"] = (max(low, -2 * grows), min(high, 2 * grows))
    if "error" in maps:
        # Angles between directions are not negative.
        signed = "truth" in maps
        limits["error"] = error_limits(maps["error"]) if signed else size_limits(maps["error"])
    if "std" in maps:
        limits["std"] = size_limits(maps["std"])
    return limits


def value_limits(*maps: Map) -> Limits:
    """Return limits that span 99 % of the finite values of all maps together; (0, 1) without any."""
    values = np.concatenate([_sample(values) for values in maps]) if maps else np.empty(0)
    if not values.size:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(values, [0.5, 99.5]))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        pad = 0.05 * abs(low) or 1.0
        return low - pad, high + pad
    return low, high


def error_limits(values: Map) -> Limits:
    """Return symmetric limits that span 98 % of the finite values; (-1, 1) without any, or if all are zero."""
    high = size_limits(values)[1]
    return -high, high


def size_limits(values: Map) -> Limits:
    """Return limits from zero that span 98 % of the finite absolute values; (0, 1) without any."""
    sizes = np.abs(_sample(values))
    high = float(np.percentile(sizes, 98)) if sizes.size else 0.0
    return 0.0, high if high > 0 else float(sizes.max(initial=0.0)) or 1.0


def _sample(values: Map) -> Map:
    step = max(1, int(np.sqrt(values.size / _EVERY)))
    some = values[::step, ::step]
    some = some[np.isfinite(some)]
    # If few values are finite, all of them are used.
    return some if some.size > 100 else values[np.isfinite(values)]


_BLOCK_PX = 32
"""Side of the squares over which the largest errors are searched, in pixels of the map."""


@dataclass(frozen=True)
class ErrorHotspot:
    """Largest error, RMSE and side of the square of 32 pixels of the map with the largest errors, in full-image px.

    ``left``, ``top``: The first column and row of the square.
    """

    x: float
    y: float
    rmse: float
    side_px: float
    left: float
    top: float


def find_error_hotspots(layers: Mapping[str, ViewerLayers], x: Map, y: Map) -> dict[str, ErrorHotspot]:
    """Return the square with the largest errors of each quantity, from columns ``x`` and rows ``y`` of the maps."""
    found = {name: _worst(errors, x, y) for name, errors in collect_error_maps(layers)}
    return {name: place for name, place in found.items() if place is not None}


def collect_error_maps(layers: Mapping[str, ViewerLayers]) -> Iterator[tuple[str, Map]]:
    """Yield the error maps, and the endpoint errors of vectors."""
    for name, one in layers.items():
        if "error" in one.maps:
            yield name, one.maps["error"]
    for name, parts in ((ENDPOINT, ("velocity_x", "velocity_y", "velocity_z")), ("flow", ("flow_x", "flow_y"))):
        maps = [layers[part].maps["error"] for part in parts if part in layers and "error" in layers[part].maps]
        if len(maps) == len(parts):
            yield name, np.sqrt(sum(values**2 for values in maps))


def _worst(errors: Map, x: Map, y: Map) -> ErrorHotspot | None:
    """Return the square with the largest RMSE among those with at least a quarter of scored pixels."""
    side = min(_BLOCK_PX, *errors.shape)
    rows, columns = errors.shape[0] // side, errors.shape[1] // side
    blocks = errors[: rows * side, : columns * side].reshape(rows, side, columns, side)
    finite = np.isfinite(blocks)
    counts = finite.sum(axis=(1, 3))
    squares = np.where(finite, blocks, 0.0) ** 2
    known = counts >= side**2 / 4
    if not known.any():
        return None
    rms = np.where(known, np.sqrt(squares.sum(axis=(1, 3)) / np.maximum(counts, 1)), -1.0)
    row, column = np.unravel_index(int(np.argmax(rms)), rms.shape)
    sizes = squares[row, :, column]
    down, across = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    width = float(abs(x[-1] - x[0])) / max(x.size - 1, 1)
    return ErrorHotspot(
        x=float(x[column * side + across]),
        y=float(y[row * side + down]),
        rmse=float(rms[row, column]),
        side_px=side * width,
        left=float(x[column * side]),
        top=float(y[row * side]),
    )

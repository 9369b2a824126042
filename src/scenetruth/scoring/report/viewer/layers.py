"""The maps of one frame that the viewer can show: estimates, truths, errors, standard deviations, and further ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import KIND_FULL, KIND_NONE, KIND_NORMAL, intrinsics_of
from scenetruth.scoring.differences import angle_deg
from scenetruth.scoring.growth import growth_maps, surface_growth
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.reading import full_pixels, percent_per_hour, quantities_of, read_quantity, read_std, tells
from scenetruth.settings import ScoreSettings

__all__ = ["Layers", "layers_of", "thinned"]

Map = NDArray[np.float64]

_MAIN = ("depth", "disparity", "velocity", "flow", "growth", "windowed growth")
"""Groups of quantities that come before all others where there is not room for all."""
_KINDS = {KIND_NONE: "none", KIND_NORMAL: "normal", KIND_FULL: "full"}
_MAP_DIMS = ("t", "y", "x")
_UNTOLD = ("face_id", "mixed", "depth", "disparity", "growth_rate", "boundary_distance")
"""Variables of a truth that are shown otherwise, or whose numbers mean nothing."""


@dataclass(frozen=True)
class Layers:
    """The maps of one quantity in one frame.

    Parameters
    ----------
    name, title, symbol, units
        What it is.
    main
        Whether it comes before others where there is not room for all.
    maps
        ``estimate``, ``truth``, ``error`` and ``std`` of a quantity, or ``value`` of what is not compared; float64, or
        integers for codes, shape (y, x), NaN where there is none.
    codes
        What the values mean, of a map of codes.
    """

    name: str
    title: str
    symbol: str
    units: str
    main: bool
    maps: Mapping[str, NDArray[Any]]
    codes: Mapping[int, str] = field(default_factory=dict)


def layers_of(
    estimate: xr.Dataset, truth: xr.Dataset | None, settings: ScoreSettings, *, grows: bool, step: int
) -> Iterator[Layers]:
    """Give the maps of one frame, those that tell most first.

    An estimate is NaN wherever its kind is not full, as in the score.

    Parameters
    ----------
    estimate, truth
        One frame of an estimate, and the truth that is aligned with it, if there is one.
    settings
        Of the windows in which growth is measured.
    grows
        Whether growth is worth showing.
    step
        Every how manieth row and column is kept, so that large images fit into a page.
    """
    names = _shown(estimate, truth, grows=grows)
    # Which pixels are known is read once for each variable, and not for each of its components.
    known: dict[str, NDArray[np.bool_]] = {}
    for name in sorted(names, key=lambda name: QUANTITIES[name].group not in _MAIN):
        entry = QUANTITIES[name]
        maps: dict[str, Map] = {}
        has = entry.variable in estimate
        if has and entry.variable not in known:
            known[entry.variable] = thinned(full_pixels(estimate, entry.variable), step)
        told = truth is not None and tells(truth, name)
        if entry.error == "difference":
            if has:
                maps["estimate"] = np.where(known[entry.variable], thinned(read_quantity(estimate, name), step), np.nan)
            if told and truth is not None:
                maps["truth"] = thinned(read_quantity(truth, name), step)
            if len(maps) == 2:
                maps["error"] = maps["estimate"] - maps["truth"]
        elif has and told and truth is not None and entry.error != "distance":
            angle = angle_deg(
                read_quantity(estimate, name), read_quantity(truth, name), lines=entry.error == "axis_angle"
            )
            maps["error"] = np.where(known[entry.variable], thinned(angle, step), np.nan)
        std = read_std(estimate, name) if maps and has else None
        if std is not None:
            maps["std"] = np.where(known[entry.variable], thinned(std, step), np.nan)
        if any(np.isfinite(values).any() for values in maps.values()):
            yield Layers(name, entry.title, entry.symbol, entry.units, entry.group in _MAIN, maps)
    if "growth_rate" not in estimate and grows:
        yield from _windowed(estimate, truth, settings, step)
    yield from _further(estimate, truth, step)


def thinned(values: NDArray[Any], step: int) -> NDArray[Any]:
    """Return every so manieth row and column of the one frame of a map, shape (1, y, x)."""
    return values[0, ::step, ::step]


def _shown(estimate: xr.Dataset, truth: xr.Dataset | None, *, grows: bool) -> list[str]:
    """Return the keys of `QUANTITIES` that the estimate or the truth can show."""
    of_estimate = quantities_of(estimate)
    names = []
    for name, entry in QUANTITIES.items():
        if not entry.variable or (entry.is_growth and not grows) or entry.error == "distance":
            continue
        told = truth is not None and tells(truth, name)
        if name in of_estimate or (told and (entry.error == "difference" or entry.variable in estimate)):
            names.append(name)
    return names


def _windowed(estimate: xr.Dataset, truth: xr.Dataset | None, settings: ScoreSettings, step: int) -> Iterator[Layers]:
    """Give the growth that follows from depth and velocity in windows."""
    if not {"depth", "velocity"} <= set(estimate):
        return
    factor = percent_per_hour(intrinsics_of(estimate))
    entry = QUANTITIES["growth_rate_windowed"]
    if truth is None:
        maps = {"estimate": factor * thinned(surface_growth(estimate, settings).values, step)}
    else:
        found = growth_maps(estimate, truth, settings)
        if found is None:
            return
        maps = {
            "estimate": factor * thinned(found.estimate, step),
            "truth": factor * thinned(found.truth_windowed, step),
        }
        maps["error"] = maps["estimate"] - maps["truth"]
    if np.isfinite(maps["estimate"]).any():
        yield Layers("growth_rate_windowed", entry.title, entry.symbol, entry.units, True, maps)


def _further(estimate: xr.Dataset, truth: xr.Dataset | None, step: int) -> Iterator[Layers]:
    """Give what is not compared: what the method says about itself, and what else the truth tells of every pixel."""
    compared = {entry.variable for entry in QUANTITIES.values()}
    stated = {f"{variable}_std" for variable in compared}
    parts = (("estimate", estimate, compared | stated), ("truth", truth, {*compared, *_UNTOLD}))
    for origin, part, told in parts:
        for name in () if part is None else map(str, part.data_vars):
            if part is None or name in told or part[name].dims != _MAP_DIMS:
                continue
            values = thinned(part[name].values, step)
            if values.dtype.kind not in "iubf":
                continue
            words = name.replace("_", " ").capitalize()
            title = words if origin == "estimate" else f"{words} (truth)"
            flags = values.dtype.kind in "iub" or name.startswith("kind") or name == "model_violation"
            if flags and values.dtype.kind == "f":
                values = np.nan_to_num(values).astype(np.int64)
            codes = _codes(part[name]) if flags else {}
            if name.startswith("kind"):
                codes = _KINDS
            units = str(part[name].attrs.get("units", "1"))
            yield Layers(f"{origin}.{name}", title, "", units, False, {"value": values}, codes)


def _codes(variable: xr.DataArray) -> dict[int, str]:
    """Return what the values of a variable mean, where it says so itself."""
    if variable.dtype.kind == "b":
        return {0: "no", 1: "yes"}
    numbers, words = variable.attrs.get("flag_values"), variable.attrs.get("flag_meanings")
    if numbers is None or not isinstance(words, str):
        return {}
    meant = [word.replace("_", " ") for word in words.split()]
    return {int(number): word for number, word in zip(np.atleast_1d(numbers), meant, strict=False)}

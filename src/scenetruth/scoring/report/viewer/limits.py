"""The ranges that maps are shown in at first, which leave out the few values far from all others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.report.viewer.layers import Layers

__all__ = ["error_limits", "limits_of", "scale_of", "size_limits", "value_limits"]

Map = NDArray[np.float64]
Limits = tuple[float, float]

_EVERY = 40_000
"""About so many values are enough to tell where nearly all are."""


def scale_of(what: str) -> str:
    """Return which range a map is shown in: estimate and truth share one."""
    return what if what in ("error", "std") else "value"


def limits_of(layers: Layers) -> dict[str, Limits]:
    """Return the ranges of the maps of a quantity, by what `scale_of` calls them."""
    maps = layers.maps
    limits = {}
    values = [maps[what].astype(np.float64) for what in ("estimate", "truth", "value") if what in maps]
    if values:
        limits["value"] = value_limits(*values)
    if layers.codes:
        limits["value"] = (float(min(layers.codes)), float(max(layers.codes)))
    elif layers.name.endswith(".confidence"):
        limits["value"] = (0.0, 1.0)
    if layers.name.startswith("growth") and "truth" in maps:
        # However noisy the estimate is, the truth shall be seen.
        low, high = limits["value"]
        grows = float(np.nanmax(np.abs(maps["truth"]), initial=0.0))
        if grows > 1e-9 * max(abs(low), abs(high)):
            limits["value"] = (max(low, -2 * grows), min(high, 2 * grows))
    if "error" in maps:
        # Angles between directions have no sign.
        signed = "truth" in maps
        limits["error"] = error_limits(maps["error"]) if signed else size_limits(maps["error"])
    if "std" in maps:
        limits["std"] = size_limits(maps["std"])
    return limits


def value_limits(*maps: Map) -> Limits:
    """Return limits that hold 99 % of the finite values of all maps together; (0, 1) where there is none."""
    values = np.concatenate([_sample(values) for values in maps]) if maps else np.empty(0)
    if not values.size:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(values, [0.5, 99.5]))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        pad = 0.05 * abs(low) or 1.0
        return low - pad, high + pad
    return low, high


def error_limits(values: Map) -> Limits:
    """Return limits about zero that hold 98 % of the finite values; (-1, 1) where there is none, or all are zero."""
    high = size_limits(values)[1]
    return -high, high


def size_limits(values: Map) -> Limits:
    """Return limits from zero on that hold 98 % of the sizes of the finite values; (0, 1) where there is none."""
    sizes = np.abs(_sample(values))
    high = float(np.percentile(sizes, 98)) if sizes.size else 0.0
    return 0.0, high if high > 0 else float(sizes.max(initial=0.0)) or 1.0


def _sample(values: Map) -> Map:
    step = max(1, int(np.sqrt(values.size / _EVERY)))
    some = values[::step, ::step]
    some = some[np.isfinite(some)]
    # Where nearly nothing is known, all of it counts.
    return some if some.size > 100 else values[np.isfinite(values)]

"""What an estimate says by itself, without any truth: medians, spreads and densities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import intrinsics_of
from scenetruth.scoring.alignment import check_estimate
from scenetruth.scoring.growth import percent_per_hour, surface_growth
from scenetruth.scoring.quantities import QUANTITIES, full_pixels, quantities_of, read_quantity, read_std, units_of

__all__ = ["MapSummary", "describe_maps"]

Map = NDArray[np.float64]


@dataclass(frozen=True)
class MapSummary:
    """The values of one quantity over all frames.

    Parameters
    ----------
    title, units
        What it is, and its units.
    median, low, high
        The median, and the 5th and 95th percentile of the known values, in ``units``; None where nothing is known.
    median_std
        The median of the standard deviations that the estimate states at these pixels, in ``units``, or None.
    density
        The share of all pixels where the quantity is known, 0 to 1.
    count
        How many pixels that is.
    """

    title: str
    units: str
    median: float | None
    low: float | None
    high: float | None
    median_std: float | None
    density: float
    count: int


def describe_maps(estimate: xr.Dataset) -> dict[str, MapSummary]:
    """Return the summaries of what an estimate holds: the keys of `QUANTITIES`, and ``growth_rate``.

    A pixel counts where the estimate is finite and claims to know the quantity (see `full_pixels`). Growth follows from
    depth and velocity, in % per hour (see `surface_growth`); it is left out where no window holds enough.

    Raises
    ------
    ScoreError
        If the estimate does not have the agreed form; lists what is wrong.
    """
    check_estimate(estimate)
    found = {}
    for name in quantities_of(estimate):
        entry = QUANTITIES[name]
        full = full_pixels(estimate, entry.variable)
        values = np.where(full, read_quantity(estimate, name), np.nan)
        found[name] = _summary(entry.title, entry.units, values, read_std(estimate, name))
    if {"depth", "velocity"} <= set(estimate):
        growth = percent_per_hour(intrinsics_of(estimate)) * surface_growth(estimate).values
        if np.isfinite(growth).any():
            found["growth_rate"] = _summary("Growth rate", units_of("growth_rate"), growth, None)
    return found


def _summary(title: str, units: str, values: Map, std: Map | None) -> MapSummary:
    known = np.isfinite(values)
    count = int(known.sum())
    stated = np.empty(0) if std is None else std[known & np.isfinite(std) & (std > 0)]
    low, median, high = np.percentile(values[known], [5, 50, 95]).tolist() if count else (None, None, None)
    return MapSummary(
        title=title,
        units=units,
        median=median,
        low=low,
        high=high,
        median_std=float(np.median(stated)) if stated.size else None,
        density=count / values.size,
        count=count,
    )

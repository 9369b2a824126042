"""What an estimate says by itself, without any truth: medians, spreads and densities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import intrinsics_of
from scenetruth.scoring.alignment import check_estimate
from scenetruth.scoring.growth import surface_growth
from scenetruth.scoring.parts import part_count, parts_of
from scenetruth.scoring.quantiles import Quantiles
from scenetruth.scoring.quantities import QUANTITIES, title_of, units_of
from scenetruth.scoring.reading import full_pixels, percent_per_hour, quantities_of, read_quantity, read_std

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
    """Return the summaries of the scalars that an estimate holds, by the keys of `QUANTITIES`.

    A pixel counts where the estimate is finite and claims to know the quantity (see `full_pixels`). Where the estimate
    has no ``growth_rate`` of its own, it follows from depth and velocity (see `surface_growth`), if any window holds
    enough.

    Raises
    ------
    ScoreError
        If the estimate does not have the agreed form; lists what is wrong.
    """
    check_estimate(estimate)
    single = part_count(estimate) == 1
    found: dict[str, _Values] = {}
    for part in parts_of(estimate):
        for name in quantities_of(part):
            full = full_pixels(part, QUANTITIES[name].variable)
            values = np.where(full, read_quantity(part, name), np.nan)
            found.setdefault(name, _Values(single=single)).add(values, read_std(part, name))
        if "growth_rate" not in part and {"depth", "velocity"} <= set(part):
            growth = percent_per_hour(intrinsics_of(part)) * surface_growth(part).values
            found.setdefault("growth_rate", _Values(single=single)).add(growth, None)
    summaries = {name: values.summary(title_of(name), units_of(name)) for name, values in found.items()}
    return {name: item for name, item in summaries.items() if name != "growth_rate" or item.count}


class _Values:
    """Gathers the values of one quantity, part by part."""

    def __init__(self, *, single: bool) -> None:
        self._values, self._stds = Quantiles(single=single), Quantiles(single=single)
        self._size = self._count = self._stated = 0

    def add(self, values: Map, std: Map | None) -> None:
        known = np.isfinite(values)
        self._size += values.size
        self._count += int(known.sum())
        self._values.add(values[known])
        if std is not None:
            stated = std[known & np.isfinite(std) & (std > 0)]
            self._stated += stated.size
            self._stds.add(stated)

    def summary(self, title: str, units: str) -> MapSummary:
        low, median, high = self._values.at([5, 50, 95]) if self._count else (None, None, None)
        return MapSummary(
            title=title,
            units=units,
            median=median,
            low=low,
            high=high,
            median_std=self._stds.at([50])[0] if self._stated else None,
            density=self._count / self._size,
            count=self._count,
        )

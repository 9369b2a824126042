"""Summary statistics of the maps of an estimate, for pages without truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.number_format import format_measured, format_unit
from scenetruth.schema import read_intrinsics
from scenetruth.scoring.alignment import check_estimate, count_blocks, iterate_blocks
from scenetruth.scoring.error_pairs import (
    find_valid_pixels,
    list_quantities,
    percent_per_hour,
    read_common_std,
    read_quantity,
    read_std,
)
from scenetruth.scoring.growth_rate import compute_growth_rate
from scenetruth.scoring.quantities import QUANTITIES, get_title
from scenetruth.scoring.quantities import get_units as stored_units
from scenetruth.scoring.statistics import StreamingQuantiles

__all__ = ["MapSummary", "describe_maps", "describe_parts", "format_value", "get_units", "main_summaries"]


def get_units(name: str) -> str:
    """Return the units of a quantity as pages show them."""
    return format_unit(stored_units(name))


def format_value(value: float | None, std: float | None) -> str:
    """Format a value down to the second digit of its standard deviation; without one, with three digits.

    >>> format_value(599.846, 0.17), format_value(599.846, None)
    ('599.85', '600')
    """
    return format_measured(value, std, 9 if std else 3)


Map = NDArray[np.float64]


@dataclass(frozen=True)
class MapSummary:
    """Summary statistics of one quantity over all frames.

    ``median``, ``low``, ``high``: Median, 5th and 95th percentile of the valid values; None without any.
    ``median_std``: Median of the standard deviations that the estimate states there, or None.
    ``median_common``: Median of the part of them that pixels have in common, or None.
    ``density``, ``count``: Fraction (0 to 1) and number of pixels with a valid value.
    """

    title: str
    units: str
    median: float | None
    low: float | None
    high: float | None
    median_std: float | None
    median_common: float | None
    density: float
    count: int


def describe_maps(estimate: xr.Dataset) -> dict[str, MapSummary]:
    """Return the summaries of the valid scalar quantities of an estimate; missing growth is computed in windows."""
    return describe_parts(estimate, {"": np.ones((1, 1), dtype=np.bool_)})[""]


def describe_parts(estimate: xr.Dataset, parts: Mapping[str, NDArray[np.bool_]]) -> dict[str, dict[str, MapSummary]]:
    """Return the summaries of an estimate for several parts of the image, in one pass; ``parts``: masks by name."""
    check_estimate(estimate)
    single = count_blocks(estimate) == 1
    found: dict[str, dict[str, _Values]] = {name: {} for name in parts}

    def add(name: str, values: Map, std: Map | None = None, common: Map | None = None) -> None:
        for part, mask in parts.items():
            inside = np.broadcast_to(mask, values.shape)
            stated = [None if one is None else one[inside] for one in (std, common)]
            found[part].setdefault(name, _Values(single=single)).add(values[inside], *stated)

    for block in iterate_blocks(estimate):
        for name in list_quantities(block):
            full = find_valid_pixels(block, QUANTITIES[name].variable)
            values = np.where(full, read_quantity(block, name), np.nan)
            add(name, values, read_std(block, name), read_common_std(block, name))
        if "growth_rate" not in block and {"depth", "velocity"} <= set(block):
            add("growth_rate", percent_per_hour(read_intrinsics(block)) * compute_growth_rate(block).values)
    return {part: _summaries(values) for part, values in found.items()}


def _summaries(found: Mapping[str, _Values]) -> dict[str, MapSummary]:
    summaries = {name: values.summary(get_title(name), get_units(name)) for name, values in found.items()}
    return {name: item for name, item in summaries.items() if name != "growth_rate" or item.count}


class _Values:
    """Accumulates the values of one quantity, block by block."""

    def __init__(self, *, single: bool) -> None:
        self._values, self._stds, self._commons = (StreamingQuantiles(single=single) for _ in range(3))
        self._size = self._count = self._stated = self._common = 0

    def add(self, values: Map, std: Map | None, common: Map | None) -> None:
        known = np.isfinite(values)
        self._size += values.size
        self._count += int(known.sum())
        self._values.add(values[known])
        if std is not None:
            stated = std[known & np.isfinite(std) & (std > 0)]
            self._stated += stated.size
            self._stds.add(stated)
        if common is not None:
            shared = common[known & np.isfinite(common)]
            self._common += shared.size
            self._commons.add(shared)

    def summary(self, title: str, units: str) -> MapSummary:
        low, median, high = self._values.at([5, 50, 95]) if self._count else (None, None, None)
        return MapSummary(
            title=title,
            units=units,
            median=median,
            low=low,
            high=high,
            median_std=self._stds.at([50])[0] if self._stated else None,
            median_common=self._commons.at([50])[0] if self._common else None,
            density=self._count / self._size,
            count=self._count,
        )


def main_summaries(summaries: Mapping[str, MapSummary]) -> list[MapSummary]:
    """Return depth, motion and growth, as available; growth with its standard deviation only."""
    found = []
    for names in (("depth", "disparity"), ("velocity_z", "flow_x"), ("growth_rate",)):
        name = next((name for name in names if name in summaries and summaries[name].count), None)
        # Growth is a small difference of large numbers: without a standard deviation, it may be noise.
        if name is not None and (name != "growth_rate" or summaries[name].median_std is not None):
            found.append(summaries[name])
    return found

"""Values of an estimate without truth by surface: depth, motion and growth of each surface that its depth shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.number_format import format_measured, format_with_std
from scenetruth.schema import read_intrinsics
from scenetruth.scoring.error_pairs import find_valid_pixels
from scenetruth.scoring.report.map_summaries import MapSummary, describe_parts, main_summaries
from scenetruth.scoring.surface_labels import fill_std, label_surfaces

__all__ = ["SurfaceTable", "describe_surfaces"]

_MOST = 12
"""Number of surfaces of the table; smaller surfaces are counted."""


@dataclass(frozen=True)
class SurfaceRow:
    """A surface: its name, its pixels, the place of its middle, and medians by quantity, spelled with their keys."""

    name: str
    pixels: int
    x: float
    y: float
    medians: tuple[tuple[float | None, str], ...]


@dataclass(frozen=True)
class SurfaceTable:
    """Values by surface; ``frame``: where the surfaces are separated; ``further``: number of smaller surfaces."""

    frame: int
    headings: tuple[str, ...]
    rows: tuple[SurfaceRow, ...]
    further: int


def describe_surfaces(estimate: xr.Dataset) -> SurfaceTable | None:
    """Return the medians of each surface of an estimate; None unless its depth shows several.

    Surfaces are those of the middle frame, the largest first, named as the objects of a twin.
    """
    if not {"depth", "depth_std"} <= set(estimate):
        return None
    frame = estimate.sizes["t"] // 2
    part = estimate.isel(t=slice(frame, frame + 1))
    labels = _labels(part)
    count = int(labels.max(initial=0))
    if count < 2:
        return None
    masks = {f"surface_{number}": labels == number for number in range(1, min(count, _MOST) + 1)}
    found = describe_parts(estimate, masks)
    names = list(dict.fromkeys(one.title for values in found.values() for one in main_summaries(values)))
    units = {one.title: one.units for values in found.values() for one in main_summaries(values)}
    headings = tuple(f"{name} [{units[name]}]" if units[name] else name for name in names)
    rows = tuple(_rows(masks, found, names, part))
    return SurfaceTable(int(part["t"].values[0]), headings, rows, count - len(rows))


def _labels(part: xr.Dataset) -> NDArray[np.int64]:
    depth = np.where(find_valid_pixels(part, "depth"), part["depth"].values, np.nan)[0].astype(np.float64)
    std = fill_std(part["depth_std"].values[0].astype(np.float64), np.isfinite(depth))
    return label_surfaces(depth, std, read_intrinsics(part).focal_length_px)


def _rows(
    masks: Mapping[str, NDArray[np.bool_]],
    found: Mapping[str, Mapping[str, MapSummary]],
    names: list[str],
    part: xr.Dataset,
) -> Iterator[SurfaceRow]:
    for name, mask in masks.items():
        values = {one.title: one for one in main_summaries(found[name])}
        rows, columns = np.nonzero(mask)
        x, y = (
            float(np.median(part[axis].values[places])) if axis in part.coords else float(np.median(places))
            for axis, places in (("x", columns), ("y", rows))
        )
        medians = tuple(_spelled(values.get(one)) for one in names)
        yield SurfaceRow(name.replace("_", " "), int(mask.sum()), x, y, medians)


def _spelled(one: MapSummary | None) -> tuple[float | None, str]:
    if one is None or one.median is None:
        return None, "–"
    if one.median_std is None:
        return one.median, format_measured(one.median, None)
    return one.median, format_with_std(one.median, one.median_std)

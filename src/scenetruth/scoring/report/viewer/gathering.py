"""Packs maps one after the other, as long as there is room in the page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring.quantities import ENDPOINT, QUANTITIES
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.report.viewer.layers import Layers
from scenetruth.scoring.report.viewer.limits import limits_of, scale_of
from scenetruth.scoring.report.viewer.packing import PackedMap, pack_map

__all__ = ["Gathered"]

_MAPS = 3_900_000
"""How many characters of the page maps may take."""
_MAIN_SHARE = 0.8
"""The share of that which the main quantities may take."""
_COARSEST = 4
_BAND_ROWS, _BANDS = 16, 4
"""The size of maps is foretold from every fourth band of so many rows."""


class Gathered:
    """Packs maps one after the other, as long as there is room.

    Parameters
    ----------
    step
        Every how manieth row and column of the images the maps have.
    """

    def __init__(self, step: int) -> None:
        self.packed: list[PackedMap] = []
        self.regions: dict[str, dict[str, Any]] = {}
        self.interior: dict[int, NDArray[np.bool_]] = {}
        self.layers: dict[tuple[str, int], Layers] = {}
        self.coarser: dict[int, list[str]] = {}
        self.frames_left_out = 0
        self.left_out: list[str] = []
        self._step = step
        self._left = float(_MAPS)
        self._groups: dict[str, dict[str, Any]] = {}

    @property
    def room(self) -> bool:
        """Whether another frame may find room."""
        return self._left > 0.05 * _MAPS

    def store(self, packed: PackedMap) -> int:
        """Keep a packed map, and return its number."""
        self.packed.append(packed)
        return len(self.packed) - 1

    def add_frame(self, t: int, found: list[Layers]) -> None:
        """Pack the maps of a frame: the main ones, and what there is room for of the others."""
        first = not self._groups
        for main in (True, False):
            some = [layers for layers in found if layers.main == main]
            share = _MAIN_SHARE if first and main else 1.0
            for layers, step in _thinnings(some, share * self._left):
                if first:
                    self.layers[layers.name, t] = layers
                if step == 0:
                    self.left_out.append(f"{layers.title}, t = {t}")
                    continue
                if step > 1:
                    self.coarser.setdefault(step, []).append(layers.title)
                self._add(t, layers, step)
        if first:
            self._add_lengths()

    def add_regions(self, t: int, truth: xr.Dataset, margin_px: float) -> None:
        """Pack where the regions of a frame lie, whose outlines can be drawn."""
        step = self._step
        inside = main_regions(truth, margin_px)["interior"][0, ::step, ::step]
        self.interior[t] = inside
        masks = {
            "interior": (f"interior, {margin_px:g} px from edges", inside),
            "edges": ("edges (mixed pixels)", truth["mixed"].values[0, ::step, ::step].astype(bool)),
        }
        if {"occluded_in_s", "occluded_in_t"} <= set(truth):
            hidden = np.zeros(inside.shape, dtype=bool)
            for name in ("occluded_in_s", "occluded_in_t"):
                hidden |= np.nan_to_num(truth[name].values[0, ::step, ::step]).astype(bool)
            masks["hidden"] = (
                "hidden from some camera or frame",
                hidden & np.isfinite(truth["depth"].values[0, ::step, ::step]),
            )
        for name, (title, mask) in masks.items():
            if mask.any():
                region = self.regions.setdefault(name, {"name": name, "title": title, "maps": {}})
                region["maps"][str(t)] = self.store(pack_map(mask))

    def groups(self) -> list[dict[str, Any]]:
        """Return what is known of every quantity, and where its maps are."""
        return list(self._groups.values())

    def _add(self, t: int, layers: Layers, step: int) -> None:
        group = self._groups.setdefault(
            layers.name,
            {
                "name": layers.name,
                "title": layers.title,
                "symbol": layers.symbol,
                "units": layers.units,
                "codes": {str(code): word for code, word in layers.codes.items()},
                "limits": limits_of(layers),
                "maps": {},
            },
        )
        numbers: dict[str, Any] = {"step": step}
        for what, values in _stored(layers):
            packed = pack_map(values[::step, ::step], group["limits"].get(scale_of(what)))
            self._left -= packed.size
            numbers[what] = self.store(packed)
        group["maps"][str(t)] = numbers

    def _add_lengths(self) -> None:
        """Add the lengths of the errors of vectors, which the page works out from their components."""
        for name, title, parts in (
            (ENDPOINT, QUANTITIES[ENDPOINT].title, ("velocity_x", "velocity_y", "velocity_z")),
            ("flow_endpoint", "Optical flow endpoint", ("flow_x", "flow_y")),
        ):
            if all("error" in self._groups.get(part, {}).get("limits", {}) for part in parts):
                high = math.hypot(*(self._groups[part]["limits"]["error"][1] for part in parts))
                self._groups[name] = {
                    "name": name,
                    "title": title,
                    "symbol": "",
                    "units": QUANTITIES[parts[0]].units,
                    "codes": {},
                    "limits": {"error": (0.0, high)},
                    "length_of": parts,
                    "maps": {},
                }


def _stored(layers: Layers) -> Iterator[tuple[str, NDArray[Any]]]:
    """Give the maps that are kept: where there are a truth and an error, the estimate is their sum."""
    maps = layers.maps
    for what, values in maps.items():
        if what == "estimate" and "error" in maps:
            rest = np.where(np.isfinite(maps["error"]), np.nan, values)
            if np.isfinite(rest).any():
                yield "rest", rest
        else:
            yield what, values


def _thinnings(found: Sequence[Layers], room: float) -> Iterator[tuple[Layers, int]]:
    """Give each quantity and how much its maps are thinned so that all find room; 0 for those that find none."""
    sizes = []
    for layers in found:
        limits = limits_of(layers)
        sizes.append(sum(_foretold_size(values, limits.get(scale_of(what))) for what, values in _stored(layers)))
    whole = sum(sizes)
    step = next((step for step in range(1, _COARSEST + 1) if whole * _share(step) <= room), _COARSEST)
    for layers, size in zip(found, sizes, strict=True):
        room -= size * _share(step)
        yield layers, step if room >= 0 else 0


def _share(step: int) -> float:
    """Return which part of its room a map takes when it is thinned."""
    # Differences between neighbours grow with their distance.
    return 1.0 if step == 1 else 1.2 / step**2


def _foretold_size(values: NDArray[Any], limits: tuple[float, float] | None) -> float:
    """Return about how many characters a map takes, from some of its rows."""
    rows = values.shape[0]
    some = np.arange(rows) // _BAND_ROWS % _BANDS == 0 if rows >= 2 * _BAND_ROWS * _BANDS else np.ones(rows, dtype=bool)
    return float(pack_map(values[some], limits).size * rows / some.sum())

"""The figure of the distributions of all errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring.figures._common import BLUE, GREY, FigureInfo, new_figure, save
from scenetruth.scoring.parts import aligned_parts, part_count
from scenetruth.scoring.quantiles import Quantiles
from scenetruth.scoring.quantities import QUANTITIES, units_of
from scenetruth.scoring.reading import Pairs
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.score import Score
from scenetruth.scoring.statistics import Scored
from scenetruth.scoring.summary import shown_quantities

__all__ = ["draw_error_histograms"]

Map = NDArray[np.float64]
Counts = NDArray[np.int64]

_BINS = 81
_RANGE = 1.5
"""Half the width of a panel, in 99th percentiles of the interior's errors."""
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": GREY, "linewidth": 1.2},
    {"color": BLUE, "linewidth": 1.0, "fill": True, "alpha": 0.55},
)
"""How ``all`` and ``interior`` are drawn."""


def draw_error_histograms(estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path) -> FigureInfo:
    """Draw the histogram of every quantity's errors in both regions, over all frames."""
    margin_px = float(score.metadata.get("margin_px", 20.0))
    names = shown_quantities(score.regions, grows=score.grows)
    edges, counts = _histograms(estimate, truth, names, margin_px)

    # A fixed layout: finding one for eight logarithmic axes takes longer than all else here.
    rows, columns = math.ceil(len(counts) / 4), min(len(counts), 4)
    width, height = max(2.75 * columns, 5.5), 2.7 * rows
    figure = new_figure(width, height, layout=None)
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.165 / width, bottom=0.46 / height, top=1 - 0.27 / height, wspace=0.2, hspace=0.38
    )
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, heights) in zip(panels.flat, counts.items(), strict=False):
        _draw_panel(axes, name, heights, edges[name], score)
    for axes in panels.flat[len(counts) :]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("pixels per bin")
    save(figure, folder / "error_histograms.png")
    caption = (
        "Estimate minus truth over all frames, in both regions, with the rms of each; counts "
        "are logarithmic. Each range is one and a half times the 99th percentile of the interior; the outermost bins "
        "also hold all that lies beyond."
    )
    return FigureInfo("error_histograms.png", "Histograms of all errors", caption)


def _histograms(
    estimate: xr.Dataset, truth: xr.Dataset, names: Sequence[str], margin_px: float
) -> tuple[dict[str, Map], dict[str, dict[str, Counts]]]:
    """Return the edges of every quantity's bins, and how many errors lie in each by region."""
    edges: dict[str, Map] = {}
    single = part_count(estimate) == 1
    if not single:
        sizes: dict[str, dict[str, Quantiles]] = {}
        for name, samples in _samples(estimate, truth, names, margin_px):
            _add(sizes.setdefault(name, {}), samples, single=False)
        edges = {name: _edges(name, regions) for name, regions in sizes.items()}
    counts: dict[str, dict[str, Counts]] = {}
    for name, samples in _samples(estimate, truth, names, margin_px):
        if single:
            edges[name] = _edges(name, _add({}, samples, single=True))
        own = counts.setdefault(name, {})
        for region, values in samples.items():
            found, _ = np.histogram(np.clip(values, edges[name][0], edges[name][-1]), edges[name])
            own[region] = own.get(region, 0) + found
    return edges, counts


def _add(sizes: dict[str, Quantiles], samples: Mapping[str, Map], *, single: bool) -> dict[str, Quantiles]:
    for region, values in samples.items():
        sizes.setdefault(region, Quantiles(single=single)).add(np.abs(values))
    return sizes


def _samples(
    estimate: xr.Dataset, truth: xr.Dataset, names: Sequence[str], margin_px: float
) -> Iterator[tuple[str, dict[str, Map]]]:
    """Give the errors of every quantity that the data sets hold in both regions, part by part."""
    for found, exact in aligned_parts(estimate, truth):
        masks = main_regions(exact, margin_px)
        pairs = Pairs(found, exact)
        for name in names:
            if name in pairs:
                one = Scored.of(pairs[name], QUANTITIES[name].error)
                yield name, {region: one.error[mask[one.scored]] for region, mask in masks.items()}


def _edges(name: str, sizes: Mapping[str, Quantiles]) -> Map:
    """Return the edges of the bins; the interior decides on their range, if anything is scored there."""
    bound = next((value for region in ("interior", "all") if np.isfinite(value := sizes[region].at([99])[0])), 0.0)
    bound = _RANGE * bound or 1.0
    return np.linspace(-bound if QUANTITIES[name].error == "difference" else 0.0, bound, _BINS + 1)


def _draw_panel(axes: Any, name: str, counts: Mapping[str, Counts], edges: Map, score: Score) -> None:
    entry = QUANTITIES[name]
    symbol = {"difference": f"error of ${entry.symbol}$", "distance": "distance"}.get(entry.error, "angle")
    axes.set_title(entry.title)
    axes.set_xlabel(f"{symbol} [{units_of(name)}]")
    axes.locator_params(axis="x", nbins=5)
    axes.set_yscale("log")
    axes.grid()
    if not counts["all"].any():
        axes.set_ylim(0.5, 10)
        axes.text(0.5, 0.5, "nothing scored", transform=axes.transAxes, ha="center", color=GREY)
        return
    for (region, heights), options in zip(counts.items(), _STYLES, strict=True):
        rms = score.regions[region][name]["rms"]
        axes.stairs(heights, edges, label=f"{region}: rms {'–' if rms is None else format(rms, '.3g')}", **options)
    axes.set_xlim(edges[0], edges[-1])
    # Head room for the legend, on a logarithmic axis.
    top = axes.get_ylim()[1]
    axes.set_ylim(0.6, top * (top / 0.6) ** 0.3)
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.3)

"""Figures of errors: their distributions, and a comparison with the stated standard deviations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.number_format import format_number, format_percent_value, format_unit
from scenetruth.scoring.alignment import count_blocks, iterate_aligned_blocks
from scenetruth.scoring.error_pairs import EstimateTruthPairs, list_quantities, read_pair, read_std
from scenetruth.scoring.figures.figure_arrays import FigureArrays
from scenetruth.scoring.figures.figure_style import (
    BLUE,
    GREY,
    ORANGE,
    FigureInfo,
    colorbar,
    map_height,
    new_figure,
    pixel_axes,
    robust_limits,
    save,
    show_map,
    unit_label,
    void_legend,
)
from scenetruth.scoring.quantities import QUANTITIES, get_units
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.score_result import Score, includes_fallback, select_summary_quantities
from scenetruth.scoring.statistics import ErrorSamples, StreamingQuantiles, standardised

__all__ = ["draw_error_bars", "draw_error_histograms"]


Map = NDArray[np.float64]
Counts = NDArray[np.int64]

_HISTOGRAM_BINS = 81
_RANGE = 1.5
"""Half the width of a panel, in 99th percentiles of the interior's errors."""
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": GREY, "linewidth": 1.2},
    {"color": BLUE, "linewidth": 1.0, "fill": True, "alpha": 0.55},
)
"""Drawing options of ``all`` and ``interior``."""


def draw_error_histograms(estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path) -> FigureInfo:
    """Draw the error histogram of every quantity in both regions, over all frames."""
    margin_px = float(score.metadata.get("margin_px", 20.0))
    names = select_summary_quantities(score.regions, grows=score.grows)
    edges, counts = _histograms(estimate, truth, names, margin_px, include_fallback=includes_fallback(score))

    # A fixed layout: the layout engine takes longer than all other steps for eight logarithmic axes.
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
        "Errors e = estimate − truth over all frames, in both regions, with the RMSE of each; counts are logarithmic. "
        "Each panel spans 1.5 times the 99th percentile of the interior to either side; the outermost bins also "
        "contain all errors beyond."
    )
    return FigureInfo("error_histograms.png", "Histograms of all errors", caption)


def _histograms(
    estimate: xr.Dataset, truth: xr.Dataset, names: Sequence[str], margin_px: float, *, include_fallback: bool
) -> tuple[dict[str, Map], dict[str, dict[str, Counts]]]:
    """Return the bin edges of every quantity, and the error counts per bin by region."""
    edges: dict[str, Map] = {}
    single = count_blocks(estimate) == 1
    if not single:
        sizes: dict[str, dict[str, StreamingQuantiles]] = {}
        for name, samples in iterate_error_samples(
            estimate, truth, names, margin_px, include_fallback=include_fallback
        ):
            _add(sizes.setdefault(name, {}), samples, single=False)
        edges = {name: _edges(name, regions) for name, regions in sizes.items()}
    counts: dict[str, dict[str, Counts]] = {}
    for name, samples in iterate_error_samples(estimate, truth, names, margin_px, include_fallback=include_fallback):
        if single:
            edges[name] = _edges(name, _add({}, samples, single=True))
        own = counts.setdefault(name, {})
        for region, values in samples.items():
            found, _ = np.histogram(np.clip(values, edges[name][0], edges[name][-1]), edges[name])
            own[region] = own.get(region, 0) + found
    return edges, counts


def _add(
    sizes: dict[str, StreamingQuantiles], samples: Mapping[str, Map], *, single: bool
) -> dict[str, StreamingQuantiles]:
    for region, values in samples.items():
        sizes.setdefault(region, StreamingQuantiles(single=single)).add(np.abs(values))
    return sizes


def iterate_error_samples(
    estimate: xr.Dataset, truth: xr.Dataset, names: Sequence[str], margin_px: float, *, include_fallback: bool = False
) -> Iterator[tuple[str, dict[str, Map]]]:
    """Yield the errors of every common quantity in both regions, block by block."""
    for found, exact in iterate_aligned_blocks(estimate, truth):
        masks = main_regions(exact, margin_px)
        pairs = EstimateTruthPairs(found, exact, include_fallback=include_fallback)
        for name in names:
            if name in pairs:
                one = ErrorSamples.of(pairs[name], QUANTITIES[name].error)
                yield name, {region: one.error[mask[one.scored]] for region, mask in masks.items()}


def _edges(name: str, sizes: Mapping[str, StreamingQuantiles]) -> Map:
    """Return the bin edges; the range is set by the interior if any of its pixels is scored."""
    bound = next((value for region in ("interior", "all") if np.isfinite(value := sizes[region].at([99])[0])), 0.0)
    bound = _RANGE * bound or 1.0
    return np.linspace(-bound if QUANTITIES[name].error == "difference" else 0.0, bound, _HISTOGRAM_BINS + 1)


def _draw_panel(axes: Any, name: str, counts: Mapping[str, Counts], edges: Map, score: Score) -> None:
    entry = QUANTITIES[name]
    symbol = {"difference": f"error of ${entry.symbol}$", "distance": "distance"}.get(entry.error, "angle")
    axes.set_title(entry.title)
    axes.set_xlabel(f"{symbol}{unit_label(get_units(name))}")
    axes.locator_params(axis="x", nbins=5)
    axes.set_yscale("log")
    axes.grid()
    if not counts["all"].any():
        axes.set_ylim(0.5, 10)
        axes.text(0.5, 0.5, "no scored pixels", transform=axes.transAxes, ha="center", color=GREY)
        return
    for (region, heights), options in zip(counts.items(), _STYLES, strict=True):
        rms = score.regions[region][name]["rmse"]
        axes.stairs(
            heights, edges, label=f"{region}: RMSE {format_number(rms)} {format_unit(get_units(name))}", **options
        )
    axes.set_xlim(edges[0], edges[-1])
    # Space for the legend above the logarithmic axis.
    top = axes.get_ylim()[1]
    axes.set_ylim(0.6, top * (top / 0.6) ** 0.3)
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.3)


_COLOURS = {"depth": BLUE, "disparity": BLUE, "velocity_x": ORANGE, "velocity_y": "#009e73", "velocity_z": "#b0006d"}
_REACH, _BINS = 5.0, 50
"""Half the width of the histogram, in standard deviations, and its bins."""
_EDGES = np.linspace(-_REACH, _REACH, _BINS + 1)


def draw_error_bars(
    views: FigureArrays, estimate: xr.Dataset, truth: xr.Dataset | None, score: Score | None, folder: Path
) -> FigureInfo | None:
    """Draw the stated standard deviations, if any, and with a score the histogram of the normalised errors."""
    names = [name for name in _mapped(views) if np.any(np.isfinite(views.stds[name]) & (views.stds[name] > 0))]
    ratios = {} if truth is None or score is None else _interior_ratios(estimate, truth, score)
    panels = len(names) + bool(ratios)
    if not panels:
        return None
    figure = new_figure(5.2 * panels + 0.2, max(map_height(views.image, 3.9, 1.0), 3.6))
    places = list(figure.subplots(1, panels, squeeze=False)[0])
    caption = []
    for name in names:
        _draw_map(figure, places.pop(0), views, name)
    if names:
        void_legend(figure, "no valid estimate, or no standard deviation")
        caption.append(
            f"The standard deviations stated by the method, t = {views.frame}; the logarithmic scales span the central "
            "98 %."
        )
    if ratios and score is not None:
        _draw_histogram(places.pop(0), ratios, score)
        caption.append(
            "Errors divided by the standard deviation that the method states for the same pixel, in the interior "
            "over all frames. Correct standard deviations give the standard normal curve, with an RMS of 1 and 95.4 % "
            "within 2 standard deviations; a wider histogram indicates standard deviations that are too small. The "
            "outermost bins also contain all values beyond."
        )
    save(figure, folder / "error_bars.png")
    shown = dict.fromkeys(QUANTITIES[name].variable for name in (*names, *ratios))
    title = f"Stated standard deviations of {' and '.join(shown)}"
    return FigureInfo("error_bars.png", title, " ".join(caption))


def _mapped(views: FigureArrays) -> list[str]:
    """Return the quantities whose standard deviations are drawn as maps: disparity only in the absence of depth."""
    names = [name for name in ("depth", "disparity", "velocity_z") if name in views.stds]
    return [name for name in names if name != "disparity" or "depth" not in names]


def _interior_ratios(estimate: xr.Dataset, truth: xr.Dataset, score: Score) -> dict[str, NDArray[np.int64]]:
    """Return the histograms of the normalised errors in the interior by quantity; empty histograms are omitted."""
    margin_px = float(score.metadata.get("margin_px", 20.0))
    counts: dict[str, NDArray[np.int64]] = {}
    for found, exact in iterate_aligned_blocks(estimate, truth):
        interior = main_regions(exact, margin_px)["interior"]
        for name in list_quantities(found):
            # An earlier score may lack quantities of the estimate.
            shown = name in _COLOURS and name in score.regions["interior"]
            std = read_std(found, name) if shown else None
            if std is None:
                continue
            scored = ErrorSamples.of(read_pair(found, exact, name, include_fallback=includes_fallback(score)))
            here = interior[scored.scored]
            ratio = standardised(scored.error[here], std[scored.scored][here])
            counts[name] = counts.get(name, 0) + np.histogram(np.clip(ratio, -_REACH, _REACH), _EDGES)[0]
    known = {name: count for name, count in counts.items() if count.any()}
    return {name: count for name, count in known.items() if name != "disparity" or "depth" not in known}


def _draw_map(figure: Any, axes: Any, views: FigureArrays, name: str) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

    entry, std = QUANTITIES[name], views.stds[name]
    positive = np.where(std > 0, std, np.nan)
    low, high = robust_limits(positive)
    drawn = show_map(axes, positive, cmap="cividis", norm=LogNorm(low, high), extent=views.grid.extent)
    title = f"Standard deviation of {entry.title[0].lower()}{entry.title[1:]}"
    common = views.common.get(name)
    if common is not None and np.isfinite(common).any():
        title += f"\n{format_number(float(np.nanmedian(common)))} {entry.units} (median) common to all pixels"
    axes.set_title(title)
    pixel_axes(axes)
    # Less than a decade may contain no major tick of a logarithmic scale.
    ticks = MaxNLocator(5) if high < 8 * low else LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,))
    bar = colorbar(
        figure, drawn, axes, f"standard deviation of ${entry.symbol}${unit_label(entry.units)}",
        extend="both", ticks=ticks, format=FuncFormatter(lambda value, _: f"{value:g}"),
    )  # fmt: skip
    bar.minorticks_off()


def _draw_histogram(axes: Any, ratios: Mapping[str, NDArray[np.int64]], score: Score) -> None:
    middle = np.linspace(-_REACH, _REACH, 401)
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    highest = float(normal.max())
    axes.fill_between(middle, normal, color=GREY, alpha=0.25, linewidth=0, label="standard normal")
    for name, counts in ratios.items():
        density = counts / (counts.sum() * np.diff(_EDGES))
        # The values beyond may be the majority and must not flatten the curve.
        highest = max(highest, float(density[1:-1].max()))
        values = score.regions["interior"][name]
        label = (
            f"${QUANTITIES[name].symbol}$: RMS of z {format_number(values['rms_z'])}, "
            f"{format_percent_value(values['coverage_2_std'])} % within 2 std"
        )
        axes.stairs(density, _EDGES, color=_COLOURS[name], linewidth=1.1, label=label)
    axes.set_title("Normalised errors z, interior")
    axes.set_xlabel("error / stated standard deviation")
    axes.set_ylabel("probability density")
    axes.set_xlim(-_REACH, _REACH)
    # Space for the legend above the curves.
    axes.set_ylim(0, 1.5 * highest)
    axes.grid()
    axes.legend(loc="upper center", borderaxespad=0.3)

"""The figure of the distributions of all errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring.alignment import align
from scenetruth.scoring.differences import difference, length
from scenetruth.scoring.figures._common import BLUE, GREY, FigureInfo, new_figure, save
from scenetruth.scoring.quantities import ENDPOINT, QUANTITIES, Pair, read_pairs, units_of
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.score import Score

__all__ = ["draw_error_histograms"]

Map = NDArray[np.float64]

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
    estimate, truth = align(estimate, truth)
    masks = main_regions(truth, float(score.metadata.get("margin_px", 20.0)))
    errors = _errors(read_pairs(estimate, truth))

    # A fixed layout: finding one for eight logarithmic axes takes longer than all else here.
    rows, columns = math.ceil(len(errors) / 4), min(len(errors), 4)
    width, height = max(2.75 * columns, 5.5), 2.7 * rows
    figure = new_figure(width, height, layout=None)
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.165 / width, bottom=0.46 / height, top=1 - 0.27 / height, wspace=0.2, hspace=0.38
    )
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, error) in zip(panels.flat, errors.items(), strict=False):
        usable = np.isfinite(error)
        samples = {region: error[mask & usable] for region, mask in masks.items()}
        _draw_panel(axes, name, samples, score)
    for axes in panels.flat[len(errors) :]:
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


def _errors(pairs: Mapping[str, Pair]) -> dict[str, Map]:
    """Return the errors of every quantity, and of the velocity's endpoint; NaN where the estimate is not full."""
    errors = {
        name: np.where(True if pair.full is None else pair.full, difference(pair.estimate, pair.truth), np.nan)
        for name, pair in pairs.items()
    }
    if "velocity_z" in errors:
        errors[ENDPOINT] = length(np.stack([errors[f"velocity_{axis}"] for axis in "xyz"]))
    return errors


def _draw_panel(axes: Any, name: str, samples: Mapping[str, Map], score: Score) -> None:
    symbol = "distance" if name == ENDPOINT else f"error of ${QUANTITIES[name].symbol}$"
    axes.set_title("Velocity, endpoint" if name == ENDPOINT else QUANTITIES[name].title)
    axes.set_xlabel(f"{symbol} [{units_of(name)}]")
    axes.locator_params(axis="x", nbins=5)
    axes.set_yscale("log")
    axes.grid()
    if not samples["all"].size:
        axes.set_ylim(0.5, 10)
        axes.text(0.5, 0.5, "nothing scored", transform=axes.transAxes, ha="center", color=GREY)
        return
    basis = samples["interior"] if samples["interior"].size else samples["all"]
    bound = _RANGE * float(np.percentile(np.abs(basis), 99)) or 1.0
    edges = np.linspace(0.0 if name == ENDPOINT else -bound, bound, _BINS + 1)
    for (region, values), options in zip(samples.items(), _STYLES, strict=True):
        counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
        rms = score.regions[region][name]["rms"]
        axes.stairs(counts, edges, label=f"{region}: rms {'–' if rms is None else format(rms, '.3g')}", **options)
    axes.set_xlim(edges[0], edges[-1])
    # Head room for the legend, on a logarithmic axis.
    top = axes.get_ylim()[1]
    axes.set_ylim(0.6, top * (top / 0.6) ** 0.3)
    axes.legend(loc="upper right", handlelength=1.2, borderaxespad=0.3)

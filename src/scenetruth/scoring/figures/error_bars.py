"""The figure of the error bars: how large they are, and whether the errors are as large as they say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring._format import format_number, format_percent
from scenetruth.scoring.alignment import align
from scenetruth.scoring.figures._common import (
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
    void_legend,
)
from scenetruth.scoring.figures._views import Views
from scenetruth.scoring.quantities import QUANTITIES, full_pixels, read_quantity, read_std
from scenetruth.scoring.regions import region_masks
from scenetruth.scoring.score import Score
from scenetruth.scoring.statistics import standardised

__all__ = ["draw_error_bars"]

Map = NDArray[np.float64]

_COLOURS = {"depth": BLUE, "velocity_x": ORANGE, "velocity_y": "#009e73", "velocity_z": "#b0006d"}
_REACH, _BINS = 5.0, 50
"""Half the width of the histogram, in standard deviations, and its bins."""


def draw_error_bars(
    views: Views, estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path
) -> FigureInfo | None:
    """Draw the standard deviation of depth, and the histogram of errors over their standard deviations.

    Returns None for an estimate that states neither for any pixel.
    """
    std = views.depth_std
    known = std is not None and bool(np.any(np.isfinite(std) & (std > 0)))
    ratios = _interior_ratios(estimate, truth, score)
    panels = int(known) + bool(ratios)
    if not panels:
        return None
    figure = new_figure(5.2 * panels + 0.2, max(map_height(views.image, 3.9, 1.0), 3.6))
    places = list(figure.subplots(1, panels, squeeze=False)[0])
    caption = []
    if known and std is not None:
        _draw_map(figure, places.pop(0), std)
        void_legend(figure, "no full estimate, or no standard deviation")
        caption.append(
            f"The standard deviation of depth that the estimator states, t = {views.frame}; the scale is logarithmic "
            "and spans the central 98 %."
        )
    if ratios:
        _draw_histogram(places.pop(0), ratios, score)
        caption.append(
            "Errors divided by the standard deviation that the estimator states for the same pixel, in the interior "
            "and over all frames. Right error bars give the unit normal curve, with a calibration (the rms of this "
            "ratio) of 1 and 95.4 % within 2 standard deviations; a wider histogram means error bars that are too "
            "small. The outermost bins also hold all that lies beyond."
        )
    save(figure, folder / "error_bars.png")
    shown = {"depth": known} | {QUANTITIES[name].variable: True for name in ratios}
    title = f"Error bars of {' and '.join(name for name, there in shown.items() if there)}"
    return FigureInfo("error_bars.png", title, " ".join(caption))


def _interior_ratios(estimate: xr.Dataset, truth: xr.Dataset, score: Score) -> dict[str, Map]:
    """Return error / standard deviation of the counted pixels of the interior, by quantity; those that have any."""
    estimate, truth = align(estimate, truth)
    margin = float(score.metadata.get("margin_px", 20.0))
    interior = region_masks(truth["depth"].values, truth["mixed"].values.astype(bool), margin)["interior"]
    ratios = {}
    for name in _COLOURS:
        std = read_std(estimate, name)
        if std is None:
            continue
        error = read_quantity(estimate, name) - read_quantity(truth, name)
        counted = interior & full_pixels(estimate, QUANTITIES[name].variable) & np.isfinite(error)
        ratios[name] = standardised(error[counted], std[counted])
    return {name: ratio for name, ratio in ratios.items() if ratio.size}


def _draw_map(figure: Any, axes: Any, std: Map) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

    positive = np.where(std > 0, std, np.nan)
    low, high = robust_limits(positive)
    drawn = show_map(axes, positive, cmap="cividis", norm=LogNorm(low, high))
    axes.set_title("Standard deviation of depth")
    pixel_axes(axes)
    # Less than a decade may hold no round number of a logarithmic scale.
    ticks = MaxNLocator(5) if high < 8 * low else LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,))
    bar = colorbar(
        figure, drawn, axes, "standard deviation of $Z$ [mm]",
        extend="both", ticks=ticks, format=FuncFormatter(lambda value, _: f"{value:g}"),
    )  # fmt: skip
    bar.minorticks_off()


def _draw_histogram(axes: Any, ratios: Mapping[str, Map], score: Score) -> None:
    edges = np.linspace(-_REACH, _REACH, _BINS + 1)
    middle = np.linspace(-_REACH, _REACH, 401)
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    highest = float(normal.max())
    axes.fill_between(middle, normal, color=GREY, alpha=0.25, linewidth=0, label="unit normal")
    for name, ratio in ratios.items():
        counts, _ = np.histogram(np.clip(ratio, -_REACH, _REACH), edges)
        density = counts / (ratio.size * np.diff(edges))
        # What lies beyond may be most; it must not flatten the curve.
        highest = max(highest, float(density[1:-1].max()))
        values = score.regions["interior"][name]
        label = (
            f"${QUANTITIES[name].symbol}$: calibration {format_number(values['calibration'])}, "
            f"{format_percent(values['within_2_std'])} % within 2 std"
        )
        axes.stairs(density, edges, color=_COLOURS[name], linewidth=1.1, label=label)
    axes.set_title("Errors in units of their standard deviation, interior")
    axes.set_xlabel("error / standard deviation [1]")
    axes.set_ylabel("probability density [1]")
    axes.set_xlim(-_REACH, _REACH)
    # Room for the legend above the curves.
    axes.set_ylim(0, 1.5 * highest)
    axes.grid()
    axes.legend(loc="upper center", borderaxespad=0.3)

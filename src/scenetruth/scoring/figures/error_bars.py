"""The figure of the error bars: how large they are, and whether the errors are as large as they say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring._format import format_number, format_percent
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
from scenetruth.scoring.parts import aligned_parts
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.reading import quantities_of, read_pair, read_std
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.score import Score
from scenetruth.scoring.statistics import Scored, standardised

__all__ = ["draw_error_bars"]

Map = NDArray[np.float64]

_COLOURS = {"depth": BLUE, "disparity": BLUE, "velocity_x": ORANGE, "velocity_y": "#009e73", "velocity_z": "#b0006d"}
_REACH, _BINS = 5.0, 50
"""Half the width of the histogram, in standard deviations, and its bins."""
_EDGES = np.linspace(-_REACH, _REACH, _BINS + 1)


def draw_error_bars(
    views: Views, estimate: xr.Dataset, truth: xr.Dataset | None, score: Score | None, folder: Path
) -> FigureInfo | None:
    """Draw the standard deviations that the estimate states, and the histogram of errors over them.

    The histogram needs a truth and a score. Returns None for an estimate that states no standard deviation.
    """
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
        void_legend(figure, "no full estimate, or no standard deviation")
        caption.append(
            f"The standard deviations that the estimator states, t = {views.frame}; scales are logarithmic and span "
            "the central 98 %."
        )
    if ratios and score is not None:
        _draw_histogram(places.pop(0), ratios, score)
        caption.append(
            "Errors divided by the standard deviation that the estimator states for the same pixel, in the interior "
            "and over all frames. Right error bars give the unit normal curve, with a calibration (the rms of this "
            "ratio) of 1 and 95.4 % within 2 standard deviations; a wider histogram means error bars that are too "
            "small. The outermost bins also hold all that lies beyond."
        )
    save(figure, folder / "error_bars.png")
    shown = dict.fromkeys(QUANTITIES[name].variable for name in (*names, *ratios))
    title = f"Error bars of {' and '.join(shown)}"
    return FigureInfo("error_bars.png", title, " ".join(caption))


def _mapped(views: Views) -> list[str]:
    """Return the quantities whose standard deviations are drawn as maps: disparity only where depth has none."""
    names = [name for name in ("depth", "disparity", "velocity_z") if name in views.stds]
    return [name for name in names if name != "disparity" or "depth" not in names]


def _interior_ratios(estimate: xr.Dataset, truth: xr.Dataset, score: Score) -> dict[str, NDArray[np.int64]]:
    """Return how often each error / standard deviation occurs in the interior, by quantity; those that have any."""
    margin_px = float(score.metadata.get("margin_px", 20.0))
    counts: dict[str, NDArray[np.int64]] = {}
    for found, exact in aligned_parts(estimate, truth):
        interior = main_regions(exact, margin_px)["interior"]
        for name in quantities_of(found):
            # A score of earlier days may lack what the estimate has.
            shown = name in _COLOURS and name in score.regions["interior"]
            std = read_std(found, name) if shown else None
            if std is None:
                continue
            scored = Scored.of(read_pair(found, exact, name))
            here = interior[scored.scored]
            ratio = standardised(scored.error[here], std[scored.scored][here])
            counts[name] = counts.get(name, 0) + np.histogram(np.clip(ratio, -_REACH, _REACH), _EDGES)[0]
    known = {name: count for name, count in counts.items() if count.any()}
    return {name: count for name, count in known.items() if name != "disparity" or "depth" not in known}


def _draw_map(figure: Any, axes: Any, views: Views, name: str) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

    entry, std = QUANTITIES[name], views.stds[name]
    positive = np.where(std > 0, std, np.nan)
    low, high = robust_limits(positive)
    drawn = show_map(axes, positive, cmap="cividis", norm=LogNorm(low, high), extent=views.grid.extent)
    axes.set_title(f"Standard deviation of {entry.title[0].lower()}{entry.title[1:]}")
    pixel_axes(axes)
    # Less than a decade may hold no round number of a logarithmic scale.
    ticks = MaxNLocator(5) if high < 8 * low else LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,))
    bar = colorbar(
        figure, drawn, axes, f"standard deviation of ${entry.symbol}$ [{entry.units}]",
        extend="both", ticks=ticks, format=FuncFormatter(lambda value, _: f"{value:g}"),
    )  # fmt: skip
    bar.minorticks_off()


def _draw_histogram(axes: Any, ratios: Mapping[str, NDArray[np.int64]], score: Score) -> None:
    middle = np.linspace(-_REACH, _REACH, 401)
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    highest = float(normal.max())
    axes.fill_between(middle, normal, color=GREY, alpha=0.25, linewidth=0, label="unit normal")
    for name, counts in ratios.items():
        density = counts / (counts.sum() * np.diff(_EDGES))
        # What lies beyond may be most; it must not flatten the curve.
        highest = max(highest, float(density[1:-1].max()))
        values = score.regions["interior"][name]
        label = (
            f"${QUANTITIES[name].symbol}$: calibration {format_number(values['calibration'])}, "
            f"{format_percent(values['within_2_std'])} % within 2 std"
        )
        axes.stairs(density, _EDGES, color=_COLOURS[name], linewidth=1.1, label=label)
    axes.set_title("Errors in units of their standard deviation, interior")
    axes.set_xlabel("error / standard deviation [1]")
    axes.set_ylabel("probability density [1]")
    axes.set_xlim(-_REACH, _REACH)
    # Room for the legend above the curves.
    axes.set_ylim(0, 1.5 * highest)
    axes.grid()
    axes.legend(loc="upper center", borderaxespad=0.3)

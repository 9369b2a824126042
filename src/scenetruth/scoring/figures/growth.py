"""The figures of the growth rate: estimate, truth, truth in the same window or error bars, and error; or that alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import intrinsics_of
from scenetruth.scoring.alignment import align
from scenetruth.scoring.figures._common import (
    FigureInfo,
    colorbar,
    map_height,
    new_figure,
    pixel_axes,
    robust_limits,
    save,
    show_map,
    symmetric_limit,
    void_legend,
)
from scenetruth.scoring.figures._views import Views
from scenetruth.scoring.growth import growth_maps, surface_growth
from scenetruth.scoring.reading import percent_per_hour
from scenetruth.scoring.score import Score
from scenetruth.settings import ScoreSettings

__all__ = ["draw_growth", "draw_growth_alone", "growth_limits"]

Map = NDArray[np.float64]

_STD = "standard deviation"


@dataclass(frozen=True)
class _Shown:
    """What the figure shows of one frame, in % per hour."""

    found: Map
    exact: Map
    third: Map | None
    third_title: str
    error: Map
    error_title: str
    void: str
    caption: str


def draw_growth(views: Views, estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path) -> FigureInfo | None:
    """Draw the growth rate of one frame; None where the truth does not know it, or no window holds enough.

    An estimate's own growth rate is compared with the truth of every pixel, with its standard deviation if that is
    stated; that which follows from depth and velocity, with the truth in the same window.
    """
    estimate, truth = align(estimate.sel(t=[views.frame]), truth)
    extent = views.grid.extent
    if "growth_rate" in estimate:
        shown = _own(views)
    else:
        shown = _windowed(estimate, truth, ScoreSettings(**score.metadata.get("score_settings", {})))
    if shown is None or not np.isfinite(shown.found).any():
        return None
    low, high = growth_limits(shown.found, shown.exact)
    bound = symmetric_limit(shown.error)

    figure = new_figure(8.6, 2 * map_height(shown.error, 3.2, 0.65) + 0.3)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    named = ((shown.found, "estimate"), (shown.exact, "truth"), (shown.third, shown.third_title))
    for axes, (values, name) in zip(panels.flat, named, strict=False):
        if values is None:
            axes.remove()
            continue
        limits = (0.0, robust_limits(values)[1]) if name == _STD else (low, high)
        drawn = show_map(axes, values, cmap="cividis", vmin=limits[0], vmax=limits[1], extent=extent)
        axes.set_title(f"Growth rate, {name}")
        colorbar(figure, drawn, axes, "growth of area [%/h]", extend="both")
    last = panels[1, 1]
    drawn = show_map(last, shown.error, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=extent)
    last.set_title(f"Error, {shown.error_title}")
    colorbar(figure, drawn, last, "error [%/h]", extend="both")
    for axes in figure.axes:
        if axes in panels.flat:
            pixel_axes(axes, label_y=axes in panels[:, 0])
    void_legend(figure, shown.void)
    save(figure, folder / "growth_rate.png")
    caption = (
        f"Relative growth of the surface's area. {shown.caption} Estimate and truth share one scale: up to twice the "
        "largest true rate, or if nothing grows 98 % of the estimates. That of the error is symmetric about zero and "
        "holds 98 % of the errors."
    )
    return FigureInfo("growth_rate.png", f"Growth rate: estimate, truth and error, t = {views.frame}", caption)


def _own(views: Views) -> _Shown | None:
    """Return the growth rate that the estimate itself holds, and that of every pixel's own element."""
    if "growth_rate" not in views.truth:
        return None
    found, exact = views.estimate["growth_rate"], views.truth["growth_rate"]
    return _Shown(
        found,
        exact,
        views.stds.get("growth_rate"),
        _STD,
        found - exact,
        "estimate − truth",
        "no surface, or no full estimate",
        "It is what the estimate itself tells of every pixel.",
    )


def _windowed(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> _Shown | None:
    """Return the growth rate that follows from depth and velocity, and from the true ones."""
    maps = growth_maps(estimate, truth, settings)
    if maps is None:
        return None
    factor = percent_per_hour(intrinsics_of(estimate))
    found, exact, windowed = (factor * values[0] for values in (maps.estimate, maps.truth, maps.truth_windowed))
    return _Shown(
        found,
        exact,
        windowed,
        "truth in the same window",
        found - windowed,
        "estimate − truth in the same window",
        "no surface, or too little known in the window",
        f"It follows from depths and velocities in a Gaussian window of {settings.growth_window_px:g} px standard "
        "deviation. The truth is shown for every pixel's own element, and as it comes out of the same windows on its "
        "own surfaces.",
    )


def draw_growth_alone(views: Views, estimate: xr.Dataset, folder: Path) -> FigureInfo | None:
    """Draw the growth rate that follows from one frame of an estimate; None where no window holds enough."""
    settings = ScoreSettings()
    own = "growth_rate" in views.estimate
    if own:
        found = views.estimate["growth_rate"]
    else:
        rate = surface_growth(estimate.sel(t=[views.frame]), settings).values[0]
        found = percent_per_hour(intrinsics_of(estimate)) * rate
    if not np.isfinite(found).any():
        return None
    bound = symmetric_limit(found)
    figure = new_figure(6.4, map_height(found, 5.1, 1.0))
    axes = figure.add_subplot(title="Growth rate, estimate")
    drawn = show_map(axes, found, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=views.grid.extent)
    colorbar(figure, drawn, axes, "growth of area [%/h]", extend="both")
    pixel_axes(axes)
    void_legend(figure, "no full estimate" if own else "too little known in the window")
    save(figure, folder / "growth_rate.png")
    window = f"from depths and velocities in a Gaussian window of {settings.growth_window_px:g} px standard deviation"
    origin = "as the estimate itself tells it" if own else window
    caption = (
        f"Relative growth of the surface's area, {origin}. The scale is symmetric about zero and holds 98 % of the "
        "estimates; red grows, blue shrinks. Noise appears as growth of either sign."
    )
    return FigureInfo("growth_rate.png", f"Growth rate: estimate, t = {views.frame}", caption)


def growth_limits(found: NDArray[np.float64], exact: NDArray[np.float64]) -> tuple[float, float]:
    """Return limits that let the truth be seen, however noisy the estimate is.

    Parameters
    ----------
    found, exact
        Estimated and true growth rates, NaN where there is none.

    Returns
    -------
    tuple of float
        Low and high: what `robust_limits` says, and no more than twice the largest true rate, if anything grows.
    """
    low, high = robust_limits(found, exact)
    grows = float(np.nanmax(np.abs(exact), initial=0.0))
    if grows > 1e-9 * max(abs(low), abs(high)):
        return max(low, -2 * grows), min(high, 2 * grows)
    return low, high

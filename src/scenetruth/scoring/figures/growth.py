"""The figures of the growth rate: estimate, truth, truth in the same window, and error; or the estimate alone."""

from __future__ import annotations

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
from scenetruth.scoring.growth import growth_maps, percent_per_hour, surface_growth
from scenetruth.scoring.score import Score
from scenetruth.settings import ScoreSettings

__all__ = ["draw_growth", "draw_growth_alone", "growth_limits"]


def draw_growth(views: Views, estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path) -> FigureInfo | None:
    """Draw the growth rate of one frame; None where the truth does not know it, or no window holds enough."""
    estimate, truth = align(estimate, truth)
    extent = views.grid.extent
    settings = ScoreSettings(**score.metadata.get("score_settings", {}))
    maps = growth_maps(estimate.sel(t=[views.frame]), truth.sel(t=[views.frame]), settings)
    if maps is None or not np.isfinite(maps.estimate).any():
        return None
    factor = percent_per_hour(intrinsics_of(estimate))
    found, exact, windowed = (factor * values[0] for values in (maps.estimate, maps.truth, maps.truth_windowed))
    error = found - windowed
    low, high = growth_limits(found, exact)
    bound = symmetric_limit(error)

    figure = new_figure(8.6, 2 * map_height(error, 3.2, 0.65) + 0.3)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    named = ((found, "estimate"), (exact, "truth"), (windowed, "truth in the same window"))
    for axes, (values, name) in zip(panels.flat, named, strict=False):
        drawn = show_map(axes, values, cmap="cividis", vmin=low, vmax=high, extent=extent)
        axes.set_title(f"Growth rate, {name}")
        colorbar(figure, drawn, axes, "growth of area [%/h]", extend="both")
    last = panels[1, 1]
    drawn = show_map(last, error, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=extent)
    last.set_title("Error, estimate − truth in the same window")
    colorbar(figure, drawn, last, "error [%/h]", extend="both")
    for axes in panels.flat:
        pixel_axes(axes, label_y=axes in panels[:, 0])
    void_legend(figure, "no surface, or too little known in the window")
    save(figure, folder / "growth_rate.png")
    caption = (
        f"Relative growth of the surface's area, from depths and velocities in a Gaussian window of "
        f"{settings.growth_window_px:g} px standard deviation. The first three share one scale: up to twice the "
        "largest true rate, or if nothing grows 98 % of the estimates. That of the error is symmetric about zero and "
        "holds 98 % of the errors. "
        "The truth is shown for every pixel's own element, and as it comes out of the same windows on its own surfaces."
    )
    return FigureInfo("growth_rate.png", f"Growth rate: estimate, truth and error, t = {views.frame}", caption)


def draw_growth_alone(views: Views, estimate: xr.Dataset, folder: Path) -> FigureInfo | None:
    """Draw the growth rate that follows from one frame of an estimate; None where no window holds enough."""
    settings = ScoreSettings()
    rate = surface_growth(estimate.sel(t=[views.frame]), settings).values[0]
    if not np.isfinite(rate).any():
        return None
    found = percent_per_hour(intrinsics_of(estimate)) * rate
    bound = symmetric_limit(found)
    figure = new_figure(6.4, map_height(found, 5.1, 1.0))
    axes = figure.add_subplot(title="Growth rate, estimate")
    drawn = show_map(axes, found, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=views.grid.extent)
    colorbar(figure, drawn, axes, "growth of area [%/h]", extend="both")
    pixel_axes(axes)
    void_legend(figure, "too little known in the window")
    save(figure, folder / "growth_rate.png")
    caption = (
        f"Relative growth of the surface's area, from depths and velocities in a Gaussian window of "
        f"{settings.growth_window_px:g} px standard deviation. The scale is symmetric about zero and holds 98 % of the "
        "estimates; red grows, blue shrinks. Noise of the velocities appears as growth of either sign."
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

"""The figure of the depth: estimate, truth and error side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenetruth.scoring.figures._common import (
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

__all__ = ["draw_depth"]


def draw_depth(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated and the true depth, and the difference of the two."""
    estimate, truth = views.estimate["depth"], views.truth["depth"]
    error = estimate - truth
    low, high = robust_limits(estimate, truth, percent=0.5)
    bound = robust_limits(np.abs(error), percent=2.0)[1]

    figure = new_figure(11.0, map_height(error, 2.75, 0.95))
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for axes, values, name in zip(panels, (estimate, truth), ("estimate", "truth"), strict=False):
        drawn = show_map(axes, values, cmap="cividis", vmin=low, vmax=high)
        axes.set_title(f"Depth, {name}")
        colorbar(figure, drawn, axes, "$Z$ [mm]", extend="both")
    drawn = show_map(panels[2], error, cmap="RdBu_r", vmin=-bound, vmax=bound)
    panels[2].set_title("Error, estimate − truth")
    colorbar(figure, drawn, panels[2], "error of $Z$ [mm]", extend="both")
    for axes in panels:
        pixel_axes(axes, label_y=axes is panels[0])
    void_legend(figure, "no full estimate, or no surface")
    save(figure, folder / "depth.png")
    caption = (
        "Estimate and truth share one scale. The scale of the error is symmetric about zero and holds 98 % of the "
        "errors; red is too far, blue too near."
    )
    return FigureInfo("depth.png", f"Depth: estimate, truth and error, t = {views.frame}", caption)

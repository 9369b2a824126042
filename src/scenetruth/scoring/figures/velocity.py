"""The figures of the velocity in Z: as grey values, and along one row."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenetruth.scoring.figures._common import (
    BLUE,
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

__all__ = ["draw_velocity_z", "draw_velocity_z_row", "pick_row"]


def pick_row(views: Views) -> int:
    """Return the row nearest the image's centre among those with almost the most estimates."""
    counts = np.isfinite(views.estimate["velocity_z"]).sum(axis=1)
    rows = np.flatnonzero(counts >= 0.95 * counts.max())
    return int(rows[np.argmin(np.abs(rows - (len(counts) - 1) / 2))])


def draw_velocity_z(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated velocity in Z as grey values, with one row marked."""
    from matplotlib.lines import Line2D

    row = pick_row(views)
    title = f"Estimated velocity in Z, t = {views.frame}"
    values = views.estimate["velocity_z"]
    low, high = robust_limits(values)
    figure = new_figure(6.4, map_height(values, 5.1, 1.0))
    axes = figure.add_subplot(title=title)
    drawn = show_map(axes, values, cmap="gray", vmin=low, vmax=high)
    axes.axhline(row, color=ORANGE, linewidth=1.2)
    pixel_axes(axes)
    colorbar(figure, drawn, axes, "$U_Z$ [mm/frame]", extend="both")
    void_legend(figure, extra=(Line2D([], [], color=ORANGE, linewidth=1.2, label=f"row {row}"),))
    save(figure, folder / "velocity_z.png")
    caption = (
        "Negative values approach the camera. The grey scale spans the central 98 % of the estimates; "
        f"row {row} is the one whose profile is shown next."
    )
    return FigureInfo("velocity_z.png", title, caption)


def draw_velocity_z_row(views: Views, folder: Path) -> FigureInfo:
    """Draw the velocity in Z along the marked row, estimate and truth."""
    row = pick_row(views)
    title = f"Velocity in Z along row {row}, t = {views.frame}"
    estimate, truth = views.estimate["velocity_z"][row], views.truth["velocity_z"][row]
    x = np.arange(estimate.size)
    low, high = robust_limits(estimate, truth, percent=0.5)
    pad = 0.15 * (high - low)
    low, high = low - pad, high + pad
    outside = int(np.sum((estimate < low) | (estimate > high)))

    figure = new_figure(8.4, 3.4)
    axes = figure.add_subplot(title=title)
    mixed = views.mixed[row]
    if mixed.any():
        axes.fill_between(
            x, 0, 1, where=mixed, step="mid", transform=axes.get_xaxis_transform(),
            color="#c3c8cf", linewidth=1.2, label="mixed pixels of the truth",
        )  # fmt: skip
    axes.plot(x, truth, color=ORANGE, linewidth=1.6, label="truth")
    axes.plot(x, estimate, color=BLUE, linewidth=0.9, label="estimate")
    axes.set_xlim(-0.5, estimate.size - 0.5)
    axes.set_ylim(low, high)
    axes.set_xlabel("x [px]")
    axes.set_ylabel("$U_Z$ [mm/frame]")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(axis="y")
    figure.legend(loc="outside lower left", ncols=4)
    save(figure, folder / "velocity_z_row.png")
    caption = (
        "Estimate and truth along the marked row. Grey bands mark mixed pixels, whose footprint crosses a silhouette "
        "or a sharp edge; gaps have no full estimate."
    )
    if outside:
        caption += f" {outside} estimate{'s lie' if outside > 1 else ' lies'} outside the range shown."
    return FigureInfo("velocity_z_row.png", title, caption)

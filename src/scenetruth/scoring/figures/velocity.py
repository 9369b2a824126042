"""The figures of the velocity in Z: as a map, and along one row."""

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
    symmetric_limit,
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
    """Draw the estimated velocity in Z twice: as grey values, with one row marked, and in colours of its sign."""
    from matplotlib.lines import Line2D

    row = views.grid.y[pick_row(views)]
    title = f"Estimated velocity in Z, t = {views.frame}"
    values = views.estimate["velocity_z"]
    low, high = robust_limits(values)
    bound = symmetric_limit(values)
    figure = new_figure(10.8, map_height(values, 4.3, 1.0))
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    drawn = show_map(left, values, cmap="gray", vmin=low, vmax=high, extent=views.grid.extent)
    left.set_title("Velocity in Z, grey values")
    left.axhline(row, color=ORANGE, linewidth=1.2)
    colorbar(figure, drawn, left, "$U_Z$ [mm/frame]", extend="both")
    drawn = show_map(right, values, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=views.grid.extent)
    right.set_title("Velocity in Z, sign and size")
    colorbar(figure, drawn, right, "$U_Z$ [mm/frame]", extend="both")
    pixel_axes(left)
    pixel_axes(right, label_y=False)
    void_legend(figure, extra=(Line2D([], [], color=ORANGE, linewidth=1.2, label=f"row {row:g}"),))
    save(figure, folder / "velocity_z.png")
    caption = (
        "Left: the grey scale spans the central 98 % of the estimates, so that small differences can be seen; "
        f"row {row:g} is the one whose profile is shown next. Right: the scale is symmetric about zero; blue "
        "(negative) approaches the camera, red moves away, and white stands still in Z."
    )
    return FigureInfo("velocity_z.png", title, caption)


def draw_velocity_z_row(views: Views, folder: Path) -> FigureInfo:
    """Draw the velocity in Z along the marked row: the estimate, and the truth if there is one."""
    from matplotlib import rc_context

    row = pick_row(views)
    title = f"Velocity in Z along row {views.grid.y[row]:g}, t = {views.frame}"
    lines = {what: values[row] for what, values in views.panels("velocity_z").items()}
    estimate, x = lines["estimate"], views.grid.x
    low, high = robust_limits(*lines.values(), percent=0.5)
    pad = 0.15 * (high - low)
    low, high = low - pad, high + pad
    outside = int(np.sum((estimate < low) | (estimate > high)))

    figure = new_figure(8.4, 3.4)
    # A power of ten, as of very low velocities, stands above the axes; the title must find a place above it.
    with rc_context({"axes.titley": None}):
        axes = figure.add_subplot(title=title)
    mixed = views.mixed[row]
    if mixed.any():
        axes.fill_between(
            x, 0, 1, where=mixed, step="mid", transform=axes.get_xaxis_transform(),
            color="#c3c8cf", linewidth=1.2, label="mixed pixels of the truth",
        )  # fmt: skip
    if "truth" in lines:
        axes.plot(x, lines["truth"], color=ORANGE, linewidth=1.6, label="truth")
    axes.plot(x, estimate, color=BLUE, linewidth=0.9, label="estimate")
    axes.set_xlim(*views.grid.extent[:2])
    axes.set_ylim(low, high)
    axes.set_xlabel("x [px]")
    axes.set_ylabel("$U_Z$ [mm/frame]")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(axis="y")
    figure.legend(loc="outside lower left", ncols=4)
    save(figure, folder / "velocity_z_row.png")
    caption = "The estimate along the marked row; gaps have no full estimate."
    if "truth" in lines:
        caption = (
            "Estimate and truth along the marked row. Grey bands mark mixed pixels, whose footprint crosses a "
            "silhouette or a sharp edge; gaps have no full estimate."
        )
    if outside:
        caption += f" {outside} estimate{'s lie' if outside > 1 else ' lies'} outside the range shown."
    return FigureInfo("velocity_z_row.png", title, caption)

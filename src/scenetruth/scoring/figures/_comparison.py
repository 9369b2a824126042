"""Maps of quantities: estimate, truth and error side by side, or the estimate alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scenetruth.scoring.figures._common import (
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
from scenetruth.scoring.quantities import QUANTITIES

__all__ = ["draw_comparison"]


def draw_comparison(views: Views, names: tuple[str, ...], file: Path, *, signed: bool = False) -> str:
    """Draw some quantities, each in a row of its own with its truth and its error, if there is a truth.

    Parameters
    ----------
    views
        The maps.
    names
        Keys of `QUANTITIES` that the estimate has.
    file
        Where the picture goes.
    signed
        Draw values about zero, with a colour map that shows their sign.

    Returns
    -------
    str
        What to see in the picture.
    """
    columns = 3 if views.truth else 1
    # Without truth, rows of one panel would waste the width.
    rows = len(names) if views.truth else 1
    columns = columns if views.truth else len(names)
    height = map_height(views.image, 2.75 if columns == 3 else 4.4, 0.65)
    figure = new_figure(11.0 if columns == 3 else 5.6 * columns, 0.3 + rows * height)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for place, name in enumerate(names):
        row = panels[place] if views.truth else panels[0, place : place + 1]
        _draw_quantity(figure, row, views, name, signed=signed)
    for axes in panels.flat:
        pixel_axes(axes, label_y=axes in panels[:, 0])
    void_legend(figure, "no full estimate, or no surface" if views.truth else "no full estimate")
    save(figure, file)
    scale = "The scale is symmetric about zero. " if signed else ""
    if not views.truth:
        return f"{scale}Each scale holds {98 if signed else 99} % of the estimates."
    return (
        f"Estimate and truth share one scale. {scale}The scale of the error is symmetric about zero and holds 98 % of "
        "the errors; red is too large, blue too small."
    )


def _draw_quantity(figure: Any, row: Any, views: Views, name: str, *, signed: bool) -> None:
    entry = QUANTITIES[name]
    shown = views.panels(name)
    if signed:
        bound = symmetric_limit(*shown.values())
        options = {"cmap": "RdBu_r", "vmin": -bound, "vmax": bound}
    else:
        low, high = robust_limits(*shown.values(), percent=0.5)
        options = {"cmap": "cividis", "vmin": low, "vmax": high}
    label = f"${entry.symbol}$ [{entry.units}]"
    for axes, (what, values) in zip(row, shown.items(), strict=False):
        drawn = show_map(axes, values, extent=views.grid.extent, **options)
        axes.set_title(f"{entry.title}, {what}")
        colorbar(figure, drawn, axes, label, extend="both")
    if "truth" in shown:
        error = shown["estimate"] - shown["truth"]
        bound = symmetric_limit(error)
        drawn = show_map(row[2], error, extent=views.grid.extent, cmap="RdBu_r", vmin=-bound, vmax=bound)
        row[2].set_title("Error, estimate − truth")
        colorbar(figure, drawn, row[2], f"error of {label}", extend="both")

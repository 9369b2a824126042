"""Plots of a sweep as image files (matplotlib)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.sweeps.plot_model import (
    PanelAxis,
    SweepCurve,
    SweepMap,
    SweepPanel,
    build_panels,
    choose_main_region,
    format_place,
    format_short,
    format_statistic_title,
    list_plotted_quantities,
)
from scenetruth.design.sweeps.sweep_result import STATISTICS, Sweep
from scenetruth.html import COLOURS
from scenetruth.output import OwnershipResult, write_atomically
from scenetruth.scoring import QUANTITIES

__all__ = ["write_static_plots"]

_MARKERS = "osDPX^*h"
_BESIDE = 2
_MOST_LABELLED = 60
_MANY_DECADES = 2.5
_WIDTH, _HEIGHT = 5.2, 3.9


def write_static_plots(found: Sweep, folder: str | Path, statistic: str = "rmse", region: str = "") -> list[Path]:
    """Write a PNG image of each quantity to a directory (atomic); return the paths."""
    made = []
    region = region or choose_main_region(found)
    with write_atomically(folder, overwrite=True, claim=_claim) as partial:
        partial.mkdir()
        for quantity in list_plotted_quantities(found):
            panels = build_panels(found, quantity, statistic, region)
            if panels:
                name = f"{quantity}_{statistic}.png"
                title = f"{format_statistic_title(quantity, statistic)}, region {region}"
                _save(plot_panels(panels, title), partial / name)
                made.append(Path(folder) / name)
    return made


def _claim(folder: Path) -> OwnershipResult:
    """Claim the plots in a directory; other files are kept."""
    if not folder.is_dir():
        return OwnershipResult("is a file, not a directory of plots")
    ours = {f"{quantity}_{statistic}.png" for quantity in QUANTITIES for statistic in STATISTICS}
    return OwnershipResult(foreign=tuple(entry.name for entry in folder.iterdir() if entry.name not in ours))


def plot_panels(panels: Sequence[SweepPanel], title: str) -> Any:
    """Return a matplotlib figure of panels side by side."""
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    beside = min(_BESIDE, len(panels))
    below = math.ceil(len(panels) / beside)
    with matplotlib.style.context(["default", {"font.size": 9, "axes.titlesize": 9, "legend.fontsize": 8}]):
        figure = Figure(figsize=(_WIDTH * beside, _HEIGHT * below + 0.3), dpi=120, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
        axes = figure.subplots(below, beside, squeeze=False).ravel()
        for place, panel in enumerate(panels):
            _draw(figure, axes[place], panel)
        for empty in axes[len(panels) :]:
            empty.set_axis_off()
    return figure


def _save(figure: Any, path: Path) -> None:
    with np.errstate(all="ignore"):
        figure.savefig(path, metadata={"Software": "scenetruth"})


def _draw(figure: Any, axes: Any, panel: SweepPanel) -> None:
    axes.set_title(panel.title, loc="left")
    axes.set_xlabel(panel.x.title)
    axes.set_ylabel(panel.y.title)
    if panel.map is not None:
        if panel.map.is_grid:
            _draw_heat(figure, axes, panel, panel.map)
        else:
            _draw_field(figure, axes, panel, panel.map)
        return
    for curve in panel.curves:
        _draw_curve(axes, panel.x, curve)
    _scale(axes, panel)
    if panel.x.names:
        axes.set_xticks(range(len(panel.x.names)), panel.x.names)
    axes.grid(color="#d7dbe0", linewidth=0.5)
    if len(panel.curves) > 1:
        # One legend entry for all bounds: each bound has the colour of its curve.
        handles, labels = axes.get_legend_handles_labels()
        values = {
            ("Cramér-Rao bound" if label.startswith("Cramér-Rao bound") else label): one
            for one, label in zip(handles, labels, strict=True)
        }
        names = sorted(values, key=lambda name: name == "Cramér-Rao bound")
        axes.legend([values[name] for name in names], names, framealpha=0.8)


def _scale(axes: Any, panel: SweepPanel) -> None:
    """Apply logarithmic scales; axes of up to 2.5 decades also have labels at 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for place, (axis, name) in enumerate(((panel.x, "x"), (panel.y, "y"))):
        if axis.logarithmic:
            getattr(axes, f"set_{name}scale")("log")
            drawn = getattr(axes, f"{name}axis")
            few = panel.decades(place) <= _MANY_DECADES
            drawn.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
            drawn.set_major_formatter(StrMethodFormatter("{x:g}"))
            drawn.set_minor_formatter(NullFormatter())


def _draw_curve(axes: Any, axis: PanelAxis, curve: SweepCurve) -> None:
    colour = COLOURS[curve.colour % len(COLOURS)]
    x = [axis.names.index(str(point[0])) if axis.names else float(point[0]) for point in curve.points]
    numbers, low, high = (np.array([point[n] for point in curve.points]) for n in (1, 2, 3))
    if curve.is_bound:
        style = {"linestyle": ":"} if curve.joined else {"linestyle": "none", "marker": "_", "markersize": 10}
        axes.plot(x, numbers, color=colour, label=curve.name, **style)
        return
    marker = _MARKERS[curve.colour % len(_MARKERS)]
    bars = np.nan_to_num(np.stack([numbers - low, high - numbers]))
    line = "-" if curve.joined else "none"
    axes.errorbar(
        x, numbers, bars, color=colour, label=curve.name, linestyle=line, marker=marker, markersize=5, elinewidth=0.8
    )


def _norm(panel: SweepPanel, numbers: Sequence[float]) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    low, high = min(numbers), max(numbers)
    if panel.logarithmic:
        return LogNorm(low, high) if high > low else LogNorm(low / 2, high * 2)
    return Normalize(low, high)


def _draw_heat(figure: Any, axes: Any, panel: SweepPanel, drawn: SweepMap) -> None:
    columns, rows = drawn.names(along_x=True), drawn.names(along_x=False)
    table = np.full((len(rows), len(columns)), np.nan)
    for cell in drawn.cells:
        table[rows.index(format_place(cell[1])), columns.index(format_place(cell[0]))] = cell[2]
    norm = _norm(panel, [cell[2] for cell in drawn.cells])
    image = axes.imshow(table, origin="lower", aspect="auto", norm=norm, cmap="viridis")
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(rows)), rows)
    if len(drawn.cells) <= _MOST_LABELLED:
        for x, y, number, low, high, bound in drawn.cells:
            text = format_short(number)
            text += f"\n{format_short(low, 2)} to {format_short(high, 2)}" if math.isfinite(low) else ""
            text += f"\n({format_short(bound, 2)})" if math.isfinite(bound) else ""
            colour = "black" if norm(number) > 0.6 else "white"
            at = columns.index(format_place(x)), rows.index(format_place(y))
            axes.text(*at, text, ha="center", va="center", color=colour, fontsize=7)
    _bar(figure, axes, image, panel)


def _draw_field(figure: Any, axes: Any, panel: SweepPanel, drawn: SweepMap) -> None:
    x, y = (
        [axis.names.index(str(cell[place])) if axis.names else float(cell[place]) for cell in drawn.cells]
        for place, axis in enumerate((panel.x, panel.y))
    )
    numbers = [cell[2] for cell in drawn.cells]
    points = axes.scatter(x, y, c=numbers, norm=_norm(panel, numbers), cmap="viridis", edgecolors="#444444", s=50)
    _scale(axes, panel)
    for axis, name in ((panel.x, "x"), (panel.y, "y")):
        if axis.names:
            getattr(axes, f"set_{name}ticks")(range(len(axis.names)), axis.names)
    _bar(figure, axes, points, panel)


def _bar(figure: Any, axes: Any, drawn: Any, panel: SweepPanel) -> None:
    bar = figure.colorbar(drawn, ax=axes, label=panel.number)
    if panel.logarithmic:
        low, high = drawn.norm.vmin, drawn.norm.vmax
        bar.set_ticks(np.geomspace(low, high, 5), labels=[format_short(one, 2) for one in np.geomspace(low, high, 5)])
        bar.minorticks_off()

"""The figures of the pages: noise and resolution of every method, and errors relative to a built-in method."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.results.comparison import GALLERY, STATISTICS
from benchmarks.results.contestants import BUILT_IN, OPENCV, SUBMITTED
from benchmarks.results.data import select
from scenetruth.html import COLOURS
from scenetruth.output import write_atomically
from scenetruth.scoring.quantities import get_title

if TYPE_CHECKING:
    from benchmarks.results.fragments import Results

__all__ = ["draw_errors", "draw_resolution"]

_STYLE = {
    "font.family": "sans-serif",
    "font.size": 9,
    "svg.fonttype": "none",
    "svg.hashsalt": "scenetruth",
    "axes.spines.top": False,
    "axes.spines.right": False,
}
_MARKERS = {BUILT_IN: "o", OPENCV: "s", SUBMITTED: "D"}
_PANELS = (
    ("period_of_depth_px", "disparity_noise_px", "Depth", "noise of disparity, px per step"),
    ("period_of_motion_px", "flow_y_noise_px", "Motion", "noise of flow, px per frame"),
)


def _colours(results: Results) -> dict[str, str]:
    return {one.title: COLOURS[place % len(COLOURS)] for place, one in enumerate(results.methods)}


def draw_resolution(results: Results, file: Path) -> Path:
    """Draw the noise of every method over the period that it resolves.

    Parameters
    ----------
    results
        The data.
    file
        The picture.
    """
    from matplotlib import pyplot

    colours = _colours(results)
    with pyplot.rc_context(_STYLE):
        figure, axes = pyplot.subplots(1, 2, figsize=(9.2, 4.2), layout="constrained")
        for axis, (period, noise, title, label) in zip(axes, _PANELS, strict=True):
            for one, row in zip(results.methods, results.overview.to_dict("records"), strict=True):
                x, y = row[period], row[noise]
                if math.isnan(x) or math.isnan(y):
                    continue
                # Beyond the longest wave that was tested.
                unresolved = math.isinf(x)
                axis.plot(
                    110 if unresolved else max(x, 1.0),
                    y,
                    marker=5 if unresolved else _MARKERS.get(one.group, "^"),
                    color=colours[one.title],
                    linestyle="none",
                    label=one.title,
                    markersize=8,
                    markeredgecolor="white",
                )
            axis.set(xlabel="period at 10 % loss, px (triangle to the right: over 96)", ylabel=label, title=title)
            if not axis.lines:
                axis.text(0.5, 0.5, "not measured yet", ha="center", va="center", transform=axis.transAxes)
                continue
            axis.set_yscale("log")
            axis.grid(alpha=0.3, which="both")
        handles: dict[str, Any] = {}
        for axis in axes:
            handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
        if handles:
            figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
        _save(figure, file)
        pyplot.close(figure)
    return file


def draw_errors(results: Results, file: Path) -> Path:
    """Draw the errors of other programs relative to the built-in method with the same images, case by case.

    Parameters
    ----------
    results
        The data.
    file
        The picture.
    """
    from matplotlib import pyplot

    wanted = [one for one in results.values if one.case != GALLERY and one.column != "bad_percent"]
    rows = {(one.case, one.quantity, one.column): row for row, one in enumerate(wanted)}
    others = [one for one in results.methods if one.group != BUILT_IN]
    colours = _colours(results)
    with pyplot.rc_context(_STYLE):
        figure, axis = pyplot.subplots(figsize=(9.2, 0.36 * len(wanted) + 1.6), layout="constrained")
        for place, other in enumerate(others):
            there = select(results.relative, program=other.title)
            points = [
                (ratio, rows[case, quantity, column] + 0.05 * (place - len(others) / 2))
                for case, quantity, column, ratio in there[["case", "quantity", "statistic", "ratio"]].to_numpy()
            ]
            if points:
                x, y = np.array(points).T
                axis.plot(
                    x,
                    y,
                    marker=_MARKERS.get(other.group, "^"),
                    linestyle="none",
                    color=colours[other.title],
                    label=other.title,
                    markersize=6,
                    markeredgecolor="white",
                )
        axis.axvline(1.0, color="#444444", linewidth=1)
        axis.set_xscale("log")
        axis.set_yticks(
            range(len(wanted)),
            [f"{one.title}: {get_title(one.quantity)}, {STATISTICS[one.column]}" for one in wanted],
        )
        axis.invert_yaxis()
        axis.set_xlabel(
            "value relative to refined with the same four images\nleft of the line, the program is more accurate"
        )
        axis.grid(alpha=0.3, axis="x", which="major")
        if axis.get_legend_handles_labels()[1]:
            figure.legend(loc="outside lower center", ncols=4, frameon=False)
        _save(figure, file)
        pyplot.close(figure)
    return file


def _save(figure: Any, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(file, overwrite=True) as partial:
        figure.savefig(partial, format="svg", facecolor="white", metadata={"Date": None})

"""Rigs as points of a chart: all that were screened, the front, simulations with their bars, the recommended one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scenetruth.design.optimise.result import Rig
from scenetruth.design.page.charts.way import Way, finite
from scenetruth.design.page.words import interval, number, said
from scenetruth.pages.charts import COLOURS

__all__ = ["cloud", "joins", "predicted", "simulated", "star"]

_GREY, _INK = "#9aa5b1", "#1b2430"
_BLUE, _RED, _GREEN = COLOURS[:3]


def cloud(x: Sequence[float], y: Sequence[float]) -> dict[str, Any]:
    """Return all that were screened, as faint points."""
    known = [(a, b) for a, b in zip(x, y, strict=True) if math.isfinite(a) and math.isfinite(b)]
    return {
        "name": "screened, within all constraints",
        "x": [a for a, _ in known],
        "y": [b for _, b in known],
        "mode": "markers",
        "marker": {"color": _GREY, "size": 4, "opacity": 0.5},
        "hoverinfo": "skip",
    }


def predicted(rigs: Sequence[Rig], x: Way, y: Way, *, joined: bool | None) -> dict[str, Any]:
    """Return what was predicted of the front, joined by a line or not, or of rigs behind it (None)."""
    return {
        "name": "alternatives, predicted" if joined is None else "front, predicted",
        "x": [finite(x.predicted(rig)) for rig in rigs],
        "y": [finite(y.predicted(rig)) for rig in rigs],
        "mode": "lines+markers" if joined else "markers",
        "line": {"color": _BLUE, "width": 1},
        "marker": {
            "color": "#ffffff",
            "symbol": "square" if joined is None else "circle",
            "size": 9,
            "line": {"color": _BLUE, "width": 2},
        },
        **_hover(rigs),
    }


def simulated(rigs: Sequence[Rig], x: Way, y: Way) -> dict[str, Any]:
    """Return what simulations of some rigs found, with bars."""
    trace: dict[str, Any] = {
        "name": "simulated, 95 %",
        "mode": "markers",
        "marker": {"color": _RED, "symbol": "diamond", "size": 9},
        **_hover(rigs),
    }
    for axis, way in (("x", x), ("y", y)):
        figures = [found for rig in rigs if (found := way.simulated(rig)) is not None]
        trace[axis] = [finite(one.number) for one in figures]
        if any(math.isfinite(one.low) for one in figures):
            trace[f"error_{axis}"] = {
                "type": "data",
                "symmetric": False,
                "array": [finite(one.high - one.number) for one in figures],
                "arrayminus": [finite(one.number - one.low) for one in figures],
                "thickness": 1,
                "color": _RED,
            }
    return trace


def joins(rigs: Sequence[Rig], x: Way, y: Way) -> dict[str, Any]:
    """Return thin lines from what was predicted to what was simulated."""
    trace: dict[str, Any] = {
        "mode": "lines",
        "line": {"color": _RED, "width": 1, "dash": "dot"},
        "showlegend": False,
        "hoverinfo": "skip",
    }
    for axis, way in (("x", x), ("y", y)):
        trace[axis] = []
        for rig in rigs:
            found = way.simulated(rig)
            trace[axis] += [finite(way.predicted(rig)), None if found is None else finite(found.number), None]
    return trace


def star(rig: Rig, x: Way, y: Way) -> dict[str, Any]:
    """Return the recommended rig."""
    return {
        "name": f"recommended: rig {rig.number}",
        "x": [finite(x.predicted(rig))],
        "y": [finite(y.predicted(rig))],
        "mode": "markers",
        "marker": {"color": _GREEN, "symbol": "star", "size": 15, "line": {"color": _INK, "width": 1}},
        **_hover([rig]),
    }


def _hover(rigs: Sequence[Rig]) -> dict[str, Any]:
    return {"customdata": [_card(rig) for rig in rigs], "hovertemplate": "%{customdata}<extra></extra>"}


def _card(rig: Rig) -> str:
    """Return what is told of a rig under the pointer."""
    lines = [f"<b>Rig {rig.number}</b>"]
    for title, value in rig.predicted.items():
        found = rig.simulated.get(title)
        told = f"{title}: predicted {number(value)}"
        if found is not None:
            between = interval(found.low, found.high)
            told += f", simulated {number(found.number)}" + (f" ({between})" if between else "")
        lines.append(told)
    return "<br>".join([*lines, *(f"{path} = {said(value)}" for path, value in rig.parameters.items())])

"""Panels of a sweep as plain values that plotly's JavaScript draws."""

from __future__ import annotations

import math
from html import escape
from typing import Any

from scenetruth.design.sweep.page.panels import Axis, Curve, Map, Panel, said, short
from scenetruth.pages.charts import COLOURS

__all__ = ["chart_of"]

_SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")
_MANY_DECADES = 2.5
_MOST_LABELLED = 100
"""Cells in which numbers can be read."""


def chart_of(panel: Panel) -> dict[str, Any]:
    """Return data, layout and words of a panel."""
    if panel.map is not None:
        data = [_heat(panel, panel.map) if panel.map.is_grid else _field(panel, panel.map)]
    else:
        data = [_trace(curve) for curve in panel.curves]
        _name_bounds_once(data, panel)
    title = panel.title if panel.map is None else "<br>".join(filter(None, (panel.title, panel.number)))
    layout = {"title": {"text": title}, "xaxis": _axis(panel.x, panel, 0), "yaxis": _axis(panel.y, panel, 1)}
    return {"data": data, "layout": layout, "alt": panel.words}


def _axis(axis: Axis, panel: Panel, place: int) -> dict[str, Any]:
    found: dict[str, Any] = {"title": {"text": axis.title, "standoff": 8}, "automargin": True}
    if axis.names:
        return found | {"type": "category", "categoryorder": "array", "categoryarray": list(axis.names)}
    if panel.map is not None and panel.map.is_grid:
        # Cells are as wide as each other, whatever lies between their values.
        names = panel.map.names(along_x=place == 0)
        return found | {"type": "category", "categoryorder": "array", "categoryarray": names}
    if not axis.logarithmic:
        return found | {"type": "linear", "exponentformat": "power"}
    # Within some decades, 2 and 5 are told too.
    return found | {"type": "log", "dtick": 1 if panel.decades(place) > _MANY_DECADES else "D2", "tickformat": "~g"}


def _name_bounds_once(data: list[dict[str, Any]], panel: Panel) -> None:
    """Let the legend tell of the bounds once: each has the colour of what it bounds."""
    bounds = [trace for trace, curve in zip(data, panel.curves, strict=True) if curve.is_bound]
    for number, trace in enumerate(bounds):
        trace |= {"legendgroup": "bound", "showlegend": number == 0, "legendrank": 2000}
        trace["name"] = "bound of noise"


def _trace(curve: Curve) -> dict[str, Any]:
    colour = COLOURS[curve.colour % len(COLOURS)]
    found: dict[str, Any] = {
        "name": curve.name,
        "x": [point[0] for point in curve.points],
        "y": [_finite(point[1]) for point in curve.points],
        "customdata": list(curve.told) or [said(point[0]) for point in curve.points],
        "hovertemplate": "%{y:.3g} at %{customdata}<extra>" + escape(curve.name) + "</extra>",
    }
    if curve.is_bound:
        if curve.joined:
            return found | {"mode": "lines", "line": {"color": colour, "dash": "dot", "width": 1.5}}
        marker = {"color": colour, "symbol": "line-ew-open", "size": 12, "line": {"width": 2}}
        return found | {"mode": "markers", "marker": marker}
    found |= {
        "mode": "lines+markers" if curve.joined else "markers",
        "line": {"color": colour},
        "marker": {"color": colour, "symbol": _SYMBOLS[curve.colour % len(_SYMBOLS)], "size": 8},
    }
    if any(math.isfinite(point[2]) for point in curve.points):
        found["error_y"] = {
            "type": "data",
            "symmetric": False,
            "array": [_finite(point[3] - point[1]) for point in curve.points],
            "arrayminus": [_finite(point[1] - point[2]) for point in curve.points],
            "thickness": 1,
        }
    return found


def _heat(panel: Panel, drawn: Map) -> dict[str, Any]:
    cells = {(said(cell[0]), said(cell[1])): cell for cell in drawn.cells}
    columns, rows = drawn.names(along_x=True), drawn.names(along_x=False)
    table = [[cells.get((x, y)) for x in columns] for y in rows]
    found = {
        "type": "heatmap",
        "x": columns,
        "y": rows,
        "z": [[None if cell is None else _scaled(cell[2], panel) for cell in row] for row in table],
        "text": [["" if cell is None else _short(cell) for cell in row] for row in table],
        "customdata": [["" if cell is None else _long(cell) for cell in row] for row in table],
        "hovertemplate": "%{x}, %{y}: %{customdata}<extra></extra>",
        "colorscale": "Viridis",
        "colorbar": _bar(panel, drawn),
    }
    return found | ({"texttemplate": "%{text}"} if len(drawn.cells) <= _MOST_LABELLED else {})


def _field(panel: Panel, drawn: Map) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [cell[0] for cell in drawn.cells],
        "y": [cell[1] for cell in drawn.cells],
        "customdata": [_long(cell) for cell in drawn.cells],
        "hovertemplate": "%{x}, %{y}: %{customdata}<extra></extra>",
        "marker": {
            "size": 12,
            "color": [_scaled(cell[2], panel) for cell in drawn.cells],
            "colorscale": "Viridis",
            "colorbar": _bar(panel, drawn),
            "line": {"width": 0.5, "color": "#444444"},
        },
    }


def _scaled(number: float, panel: Panel) -> float | None:
    return _finite(math.log10(number) if panel.logarithmic and number > 0 else number)


def _bar(panel: Panel, drawn: Map) -> dict[str, Any]:
    """Return a colour bar that tells numbers, and not their logarithms."""
    if not panel.logarithmic:
        return {"thickness": 12}
    low, high = (math.log10(each(cell[2] for cell in drawn.cells)) for each in (min, max))
    ticks = [low + (high - low) * n / 4 for n in range(5)] if high > low else [low]
    return {"thickness": 12, "tickvals": ticks, "ticktext": [short(10**tick, 2) for tick in ticks]}


def _short(cell: tuple[Any, ...]) -> str:
    _, _, number, _, _, bound = cell
    return short(number) + (f"<br>({short(bound, 2)})" if math.isfinite(bound) else "")


def _long(cell: tuple[Any, ...]) -> str:
    _, _, number, low, high, bound = cell
    interval = f", 95 %: {short(low)} to {short(high)}" if math.isfinite(low) else ""
    return short(number) + interval + (f", bound of noise {short(bound)}" if math.isfinite(bound) else "")


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None

"""The HTML report of a sweep, with charts for plotly.js."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from scenetruth.design.parameter_words import parameter_unit, title_parameters
from scenetruth.design.sweeps.factors import format_level
from scenetruth.design.sweeps.plot_model import (
    PanelAxis,
    SweepCurve,
    SweepMap,
    SweepPanel,
    build_panels,
    choose_main_region,
    describe_place,
    format_place,
    format_short,
    list_plotted_quantities,
)
from scenetruth.design.sweeps.sweep_result import STATISTICS, Sweep, SweepRecord
from scenetruth.html import COLOURS, render_page
from scenetruth.number_format import UNDEFINED, format_interval, format_measured, format_number, format_unit
from scenetruth.output import write_atomically
from scenetruth.scoring import QUANTITIES, get_units
from scenetruth.scoring.quantities import get_title
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = ["build_chart", "find_only_method", "names_methods", "write_sweep_report"]


_SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")
_MANY_DECADES = 2.5
_MOST_LABELLED = 100  # largest number of cells with printed values


def build_chart(panel: SweepPanel) -> dict[str, Any]:
    """Return the data, layout and text alternative of a panel."""
    if panel.map is not None:
        data = [_heat(panel, panel.map) if panel.map.is_grid else _field(panel, panel.map)]
    else:
        data = [_trace(curve) for curve in panel.curves]
        _name_bounds_once(data, panel)
    title = panel.title if panel.map is None else "<br>".join(filter(None, (panel.title, panel.number)))
    layout = {"title": {"text": title}, "xaxis": _axis(panel.x, panel, 0), "yaxis": _axis(panel.y, panel, 1)}
    return {"data": data, "layout": layout, "alt": panel.words}


def _axis(axis: PanelAxis, panel: SweepPanel, place: int) -> dict[str, Any]:
    found: dict[str, Any] = {"title": {"text": axis.title, "standoff": 8}, "automargin": True}
    if axis.names:
        return found | {"type": "category", "categoryorder": "array", "categoryarray": list(axis.names)}
    if panel.map is not None and panel.map.is_grid:
        names = panel.map.names(along_x=place == 0)  # all cells have the same width
        return found | {"type": "category", "categoryorder": "array", "categoryarray": names}
    if not axis.logarithmic:
        return found | {"type": "linear", "exponentformat": "power"}
    # Axes of up to 2.5 decades also have labels at 2 and 5.
    return found | {"type": "log", "dtick": 1 if panel.decades(place) > _MANY_DECADES else "D2", "tickformat": "~g"}


def _name_bounds_once(data: list[dict[str, Any]], panel: SweepPanel) -> None:
    """Use one legend entry for all bounds: each bound has the colour of its curve."""
    bounds = [trace for trace, curve in zip(data, panel.curves, strict=True) if curve.is_bound]
    for number, trace in enumerate(bounds):
        trace |= {"legendgroup": "bound", "showlegend": number == 0, "legendrank": 2000}
        trace["name"] = "Cramér-Rao bound"


def _trace(curve: SweepCurve) -> dict[str, Any]:
    colour = COLOURS[curve.colour % len(COLOURS)]
    found: dict[str, Any] = {
        "name": curve.name,
        "x": [point[0] for point in curve.points],
        "y": [_finite(point[1]) for point in curve.points],
        "customdata": list(curve.labels) or [format_place(point[0]) for point in curve.points],
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


def _heat(panel: SweepPanel, drawn: SweepMap) -> dict[str, Any]:
    cells = {(format_place(cell[0]), format_place(cell[1])): cell for cell in drawn.cells}
    # All labels of the axes: plotly places the texts of cells by the labels of the map.
    columns = list(panel.x.names) or drawn.names(along_x=True)
    rows = list(panel.y.names) or drawn.names(along_x=False)
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


def _field(panel: SweepPanel, drawn: SweepMap) -> dict[str, Any]:
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


def _scaled(number: float, panel: SweepPanel) -> float | None:
    return _finite(math.log10(number) if panel.logarithmic and number > 0 else number)


def _bar(panel: SweepPanel, drawn: SweepMap) -> dict[str, Any]:
    if not panel.logarithmic:
        return {"thickness": 12}
    low, high = (math.log10(each(cell[2] for cell in drawn.cells)) for each in (min, max))
    ticks = [low + (high - low) * n / 4 for n in range(5)] if high > low else [low]
    return {"thickness": 12, "tickvals": ticks, "ticktext": _distinct([10**tick for tick in ticks])}


def _distinct(values: list[float]) -> list[str]:
    """Return numbers with as many digits, from two on, as distinguish them."""
    texts: list[str] = []
    for digits in range(2, 7):
        texts = [format_short(value, digits) for value in values]
        if len(set(texts)) == len(texts):
            break
    return texts


def _short(cell: tuple[Any, ...]) -> str:
    _, _, number, low, high, bound = cell
    return _measured(number, low, high) + (f"<br>({format_short(bound, 2)})" if math.isfinite(bound) else "")


def _long(cell: tuple[Any, ...]) -> str:
    _, _, number, low, high, bound = cell
    between = format_interval(low, high)
    interval = f", 95 %: {between}" if between else ""
    value = _measured(number, low, high)
    return value + interval + (f", Cramér-Rao bound {format_short(bound)}" if math.isfinite(bound) else "")


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


PAGE = "index.html"
_MOST_LINES = 1000
_MOST_VALUES = 8
_STATISTIC = "rmse"
_INTERVAL = "frames.frame_interval_s"


def write_sweep_report(found: Sweep, folder: str | Path, again: str = "") -> Path:
    """Write the HTML report of a sweep; return its path."""
    quantities = list_plotted_quantities(found)
    regions = list(dict.fromkeys(row.region for row in found.rows))
    charts = {
        f"{quantity}|{statistic}|{region}": [build_chart(panel) for panel in panels]
        for quantity in quantities
        for statistic in STATISTICS
        for region in regions
        if (panels := build_panels(found, quantity, statistic, region))
    }
    statistics = [name for name in STATISTICS if any(key.split("|")[1] == name for key in charts)]
    region = choose_main_region(found)
    lines, titles = _lines(found, region), title_parameters(found.factors)
    best, only = _find_best(found, region), ""
    if names_methods(found) and (only := find_only_method([line[-1] for line in best])):
        best = [line[:-1] for line in best]
    text = render_page(
        "scenetruth.design.sweeps",
        "sweep.html.j2",
        charts,
        found=found,
        values=_values(found),
        seeds=len({row.seed for row in found.rows if row.seed is not None}),
        quantities=[(name, get_title(name)) for name in quantities],
        statistics=[(name, STATISTIC_TITLES[name]) for name in statistics],
        regions=sorted(regions, key=lambda one: one != region),
        statistic=_STATISTIC,
        region=region,
        best=best,
        only=only,
        per_frame=_INTERVAL in found.factors,
        result=_state_result(found, region),
        best_columns=[
            "quantity",
            "RMSE",
            "95 %",
            "unit",
            "at",
            *(["method"] if names_methods(found) and not only else []),
        ],
        columns=[*titles.values(), *_COLUMNS],
        titles=titles,
        lines=lines[:_MOST_LINES],
        left_out=max(0, len(lines) - _MOST_LINES),
        again=again,
    )
    path = Path(folder) / PAGE
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


_COLUMNS = (
    "scene",
    "method",
    "quantity",
    STATISTIC_TITLES["rmse"],
    "95 % of RMSE",
    *(STATISTIC_TITLES[name] for name in ("bias", "precision_std", "median_abs_error", "density")),
    "Cramér-Rao bound",
    "unit",
)


def _values(found: Sweep) -> list[tuple[str, str]]:
    entries = []
    for path in found.factors:
        values = {format_level(row.values[path]): row.values[path] for row in found.rows}
        labels = list(values)
        if all(isinstance(value, int | float) for value in values.values()):
            labels.sort(key=lambda label: float(values[label]))
        several = len(labels) > _MOST_VALUES
        text = f"{len(labels)} levels, {labels[0]} to {labels[-1]}" if several else ", ".join(labels)
        entries.append((path, f"{text} {parameter_unit(path)}".rstrip()))
    return entries


def _find_best(found: Sweep, region: str) -> list[list[str]]:
    """Return the rows of the table of smallest RMSE of each quantity."""
    lines = []
    for quantity in list_plotted_quantities(found):
        try:
            row = found.best(quantity, "rmse", region=region)
        except KeyError:
            continue
        where = describe_place(row)
        scene = f"{row.scene}: " if len(found.scenes) > 1 else ""
        method = [row.method] if names_methods(found) else []
        lines.append([get_title(quantity), _number(row), _interval(row), format_unit(row.unit), scene + where, *method])
    return lines


def names_methods(found: Sweep) -> bool:
    """Return whether points are named with their methods: levels of the method name them already."""
    return len(found.methods) > 1 and "estimate.method" not in found.factors


def find_only_method(methods: Sequence[str]) -> str:
    """Return the method of all rows of a table; empty if there are several."""
    return methods[0] if len(set(methods)) == 1 else ""


def _main_quantity(found: Sweep) -> str | None:
    """Return the quantity of the first sentence: growth if an object grows, else the first with values."""
    there = list_plotted_quantities(found)
    return next((name for name in there if QUANTITIES[name].is_growth), there[0] if there else None)


def _state_result(found: Sweep, region: str) -> str:
    """Return the smallest error of the main quantity as a sentence."""
    main = _main_quantity(found)
    lines = [] if main is None else [line for line in _find_best(found, region) if line[0] == get_title(main)]
    if not lines:
        return "No point of the sweep has a valid error."
    title, number, interval, unit, where, *method = lines[0]
    unit = "" if unit == UNDEFINED else f" {unit}"
    bars = f" (95 %: {interval})" if interval not in ("", UNDEFINED) else ""
    by = f", with {method[0]}" if method else ""
    name = f"{title[0].lower()}{title[1:]}"
    text = f"The smallest RMSE of {name} in the region {region} is {number}{unit}{bars}, at {where}{by}."
    return text + _count_similar(found, region)


def _count_similar(found: Sweep, region: str) -> str:
    """Return how many points have intervals that overlap with that of the smallest error of the main quantity."""
    main = _main_quantity(found)
    rows = [] if main is None else list(found.selected(main, "rmse", region=region, methods=found.methods))
    if not rows:
        return ""
    best = min(rows, key=lambda row: row.value)
    others = [row for row in rows if row is not best and math.isfinite(row.ci_low)]
    count = sum(row.ci_low <= best.ci_high for row in others)
    if not count:
        return ""
    which = f"{count} of the other {len(rows) - 1} points" if count < len(rows) - 1 else "all other points"
    points, verb = ("interval", "overlaps") if count == 1 == len(rows) - 1 else ("intervals", "overlap")
    which = "the other point" if verb == "overlaps" else which
    methods = f" of {'both' if len(found.methods) == 2 else 'all'} methods" if len(found.methods) > 1 else ""
    return f" The {points} of {which}{methods} {verb} with it: more seeds are needed to distinguish them."


def _lines(found: Sweep, region: str) -> list[list[str]]:
    entries: dict[tuple[Any, ...], dict[str, SweepRecord]] = {}
    bounds: dict[tuple[Any, ...], float] = {}
    shown = list_plotted_quantities(found)
    for row in found.rows:
        if row.region != region or row.seed is not None or row.quantity not in shown:
            continue
        at = tuple(format_level(value) for value in row.values.values())
        if not row.is_bound:
            entries.setdefault((*at, row.scene, row.method, row.quantity), {})[row.statistic] = row
        elif row.statistic == "rmse":
            of = row.method.removeprefix("bound").removeprefix(" of ")
            bounds[(*at, row.scene, of, row.quantity)] = row.value
    lines = []
    for key, rows in entries.items():
        *values, scene, method, quantity = key
        alone = bounds.get((*values, scene, "", quantity), math.nan)
        bound = bounds.get((*values, scene, method, quantity), alone)
        numbers = {name: _number(row) for name, row in rows.items()}
        cells = [numbers.get(name, "–") for name in ("bias", "precision_std", "median_abs_error", "density")]
        interval = _interval(rows["rmse"]) if "rmse" in rows else "–"
        lines.append(
            [
                *values,
                scene,
                method,
                get_title(quantity),
                numbers.get("rmse", "–"),
                interval,
                *cells,
                format_number(bound),
                get_units(quantity),
            ]
        )
    return lines


def _interval(row: SweepRecord) -> str:
    return format_interval(row.ci_low, row.ci_high) or UNDEFINED


def _number(row: SweepRecord) -> str:
    return _measured(row.value, row.ci_low, row.ci_high)


def _measured(value: float, low: float, high: float) -> str:
    """Return a value with the digits of its interval, two at least: values of wide intervals are compared as well."""
    half = 0.5 * (high - low)
    return format_number(value, 2) if half > abs(value) else format_measured(value, half)

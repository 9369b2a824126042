"""Writes the page of a sweep: one file of HTML that needs no network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from scenetruth.design.sweep.factors import label_of
from scenetruth.design.sweep.page.charts import chart_of
from scenetruth.design.sweep.page.panels import STATISTIC_TITLES, main_region, panels_of, short, shown_quantities
from scenetruth.design.sweep.result import Sweep
from scenetruth.design.sweep.rows import Row
from scenetruth.pages.rendering import page_of
from scenetruth.placing import write_aside
from scenetruth.scoring import units_of
from scenetruth.scoring.quantities import title_of

__all__ = ["PAGE", "write_page"]

PAGE = "index.html"
_MOST_LINES = 1000
_MOST_VALUES = 8
_STATISTIC = "rms"


def write_page(found: Sweep, folder: str | Path, again: str = "") -> Path:
    """Write the page of a sweep.

    Parameters
    ----------
    found
        The sweep.
    folder
        Where the page goes.
    again
        The command that makes it again; empty if there is none.

    Returns
    -------
    pathlib.Path
        The page.
    """
    quantities = shown_quantities(found)
    regions = list(dict.fromkeys(row.region for row in found.rows))
    charts = {
        f"{quantity}|{statistic}|{region}": [chart_of(panel) for panel in panels]
        for quantity in quantities
        for statistic in STATISTIC_TITLES
        for region in regions
        if (panels := panels_of(found, quantity, statistic, region))
    }
    statistics = [name for name in STATISTIC_TITLES if any(key.split("|")[1] == name for key in charts)]
    region = main_region(found)
    lines = _lines(found, region)
    text = page_of(
        "scenetruth.design.sweep.page",
        "sweep.html.j2",
        charts,
        found=found,
        values=_values(found),
        seeds=len({row.seed for row in found.rows if row.seed is not None}),
        quantities=[(name, title_of(name)) for name in quantities],
        statistics=[(name, STATISTIC_TITLES[name]) for name in statistics],
        regions=sorted(regions, key=lambda one: one != region),
        statistic=_STATISTIC,
        region=region,
        best=_best(found, region),
        best_columns=["quantity", "rms", "95 %", "unit", "at", *(["method"] if len(found.methods) > 1 else [])],
        columns=[*found.factors, *_COLUMNS],
        lines=lines[:_MOST_LINES],
        left_out=max(0, len(lines) - _MOST_LINES),
        again=again,
    )
    path = Path(folder) / PAGE
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    return path


_COLUMNS = ("scene", "method", "quantity", "rms", "95 % of rms", "bias", "std", "median", "density", "bound", "unit")


def _values(found: Sweep) -> list[tuple[str, str]]:
    """Return what varies, with its values in words."""
    told = []
    for path in found.factors:
        values = {label_of(row.values[path]): row.values[path] for row in found.rows}
        labels = list(values)
        if all(isinstance(value, int | float) for value in values.values()):
            labels.sort(key=lambda label: float(values[label]))
        several = len(labels) > _MOST_VALUES
        told.append((path, f"{len(labels)} values, {labels[0]} to {labels[-1]}" if several else ", ".join(labels)))
    return told


def _best(found: Sweep, region: str) -> list[list[str]]:
    """Return where each quantity has its least rms error."""
    lines = []
    for quantity in shown_quantities(found):
        try:
            row = found.best(quantity, "rms", region=region)
        except KeyError:
            continue
        where = ", ".join(f"{path} = {label_of(value)}" for path, value in row.values.items())
        scene = f"{row.scene}: " if len(found.scenes) > 1 else ""
        method = [row.method] if len(found.methods) > 1 else []
        lines.append([title_of(quantity), _number(row.number), _interval(row), row.unit, scene + where, *method])
    return lines


def _lines(found: Sweep, region: str) -> list[list[str]]:
    """Return a line for each point, method and quantity."""
    told: dict[tuple[Any, ...], dict[str, Row]] = {}
    bounds: dict[tuple[Any, ...], float] = {}
    shown = shown_quantities(found)
    for row in found.rows:
        if row.region != region or row.seed is not None or row.quantity not in shown:
            continue
        at = tuple(label_of(value) for value in row.values.values())
        if not row.is_bound:
            told.setdefault((*at, row.scene, row.method, row.quantity), {})[row.statistic] = row
        elif row.statistic == "rms":
            of = row.method.removeprefix("bound").removeprefix(" of ")
            bounds[(*at, row.scene, of, row.quantity)] = row.number
    lines = []
    for key, rows in told.items():
        *values, scene, method, quantity = key
        alone = bounds.get((*values, scene, "", quantity), math.nan)
        bound = bounds.get((*values, scene, method, quantity), alone)
        numbers = {name: _number(row.number) for name, row in rows.items()}
        cells = [numbers.get(name, "–") for name in ("bias", "std", "median", "density")]
        interval = _interval(rows["rms"]) if "rms" in rows else "–"
        lines.append(
            [
                *values,
                scene,
                method,
                quantity,
                numbers.get("rms", "–"),
                interval,
                *cells,
                _number(bound),
                units_of(quantity),
            ]
        )
    return lines


def _interval(row: Row) -> str:
    return f"{_number(row.low)} to {_number(row.high)}" if math.isfinite(row.low) else "–"


def _number(value: float) -> str:
    return short(value) if math.isfinite(value) else "–"

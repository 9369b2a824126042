"""The page of a budget: one file of HTML that needs no network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.design.budget.answer.waterfall import DRAWN, waterfalls_of
from scenetruth.design.budget.answer.words import number, unit_words
from scenetruth.pages.plotly_script import plotly_script
from scenetruth.pages.rendering import environment_of, in_script
from scenetruth.pages.tables import Cell, Table
from scenetruth.placing import write_aside

if TYPE_CHECKING:
    from scenetruth.design.budget.result import Budget

__all__ = ["PAGE", "write_page"]

PAGE = "index.html"

_TEMPLATE = """{% extends "page_with_charts.html.j2" %}
{% from "parts.html.j2" import plots, sortable %}
{% block title %}Error budget: {{ found.scene or found.method }}{% endblock %}
{% block style %}
tfoot td { color: var(--soft); }
.charts { grid-template-columns: 1fr; }
.chart { min-height: 0; }
{% endblock %}
{% block header %}
<h1>Error budget</h1>
{% endblock %}
{% block main %}
<p>{{ found.scene }}{{ "." if found.scene }}
Method: {{ found.method }}; {{ found.draws }} draw{{ "s" if found.draws > 1 }}; rms over {{ place }}.</p>
<ul>
{% for line in words %}
<li>{{ line }}</li>
{% endfor %}
</ul>
{{ plots(waterfalls) }}
<p>A part is what the estimate changes by, pixel by pixel, when its cause alone is switched on. Parts add up by their
squares; every bar reaches from the root of the sum before it to that with it. What ideal images leave counts once, as
slanted surfaces, curved surfaces and the rest. Pale bars are predicted, full ones simulated.</p>
<h2>All parts</h2>
{% for table in tables %}
{{ sortable(table) }}
{% endfor %}
{% for line in found.failures %}
<p>Not simulated: {{ line }}</p>
{% endfor %}
{% endblock %}
"""

_COLUMNS = ("cause", "size", "part", "predicted", "predicted, drawn", "simulated", "pixels told")
_PLACES = {"interior": "the interior", "all": "all that is seen"}


def write_page(found: Budget, folder: Path, region: str = "interior") -> Path:
    """Write the page of a budget.

    Parameters
    ----------
    found
        The budget.
    folder
        Where it goes.
    region
        Where its figures are from.

    Returns
    -------
    pathlib.Path
        The page.
    """
    environment = environment_of("scenetruth.pages")
    tables = []
    for quantity in DRAWN:
        parts = found.of(quantity, region)
        if not parts:
            continue
        total = found.total(quantity, region)
        lines = [
            [
                Cell(one.title),
                # Of several units: nothing to sort numbers by.
                Cell(one.size),
                *(_cell(value) for value in (one.figure, one.predicted, one.drawn, one.simulated)),
                _share(one.seen),
            ]
            for one in parts
        ]
        foot = [
            [Cell(text) for text in cells]
            for cells in (
                ("root of the sum of squares", "", number(total.parts), "", "", "", ""),
                ("added up pixel by pixel", "", number(total.added), "", "", "", ""),
                ("everything on", "", "", "", "", number(total.simulated), _share(total.seen).text),
            )
        ]
        caption = f"{quantity.replace('_', ' ')}, {unit_words(total.unit)}"
        tables.append(Table(f"parts-{quantity}", caption, _COLUMNS, lines, foot=foot))
    waterfalls = waterfalls_of(found, region)
    text = environment.from_string(_TEMPLATE).render(
        found=found,
        place=_PLACES.get(region, f"the interior of {region.removeprefix('object_')}"),
        words=found.words(region),
        waterfalls=waterfalls,
        tables=tables,
        plotly=plotly_script(),
        charts=in_script({one.name: {"data": one.data, "layout": one.layout} for one in waterfalls}),
    )
    path = folder / PAGE
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    return path


def _cell(value: float) -> Cell:
    return Cell(number(value), value)


def _share(value: float) -> Cell:
    return Cell(f"{100 * value:.0f} %" if math.isfinite(value) else "–", value)

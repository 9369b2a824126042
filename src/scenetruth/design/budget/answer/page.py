"""The page of a budget: one file of HTML that needs no network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.design.budget.answer.waterfall import DRAWN, waterfall_html
from scenetruth.design.budget.answer.words import number, unit_words
from scenetruth.pages.rendering import environment_of
from scenetruth.placing import write_aside

if TYPE_CHECKING:
    from scenetruth.design.budget.result import Budget

__all__ = ["PAGE", "write_page"]

PAGE = "index.html"

_TEMPLATE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Error budget: {{ found.scene or found.method }}</title>
{% include "style.html.j2" %}
<style>td:first-child, th:first-child, td:nth-child(2), th:nth-child(2) { text-align: left; }</style>
<script>{{ plotly | safe }}</script>
</head>
<body>
<main>
<h1>Error budget</h1>
<p>{{ found.scene }}{{ "." if found.scene }}
Method: {{ found.method }}; {{ found.draws }} draw{{ "s" if found.draws > 1 }}; rms over {{ place }}.</p>
<ul>
{% for line in words %}
<li>{{ line }}</li>
{% endfor %}
</ul>
{{ waterfalls | safe }}
<p>A part is what the estimate changes by, pixel by pixel, when its cause alone is switched on. Parts add up by their
squares; every bar reaches from the root of the sum before it to that with it. What ideal images leave counts once, as
slanted surfaces, curved surfaces and the rest. Pale bars are predicted, full ones simulated.</p>
<h2>All parts</h2>
{% for table in tables %}
<h3>{{ table.title }}</h3>
<table>
<thead><tr><th>cause</th><th>size</th><th>part</th><th>predicted</th><th>predicted, drawn</th><th>simulated</th>
<th>pixels told</th></tr></thead>
<tbody>
{% for cells in table.rows %}
<tr>{% for cell in cells %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</tbody>
</table>
{% endfor %}
{% for line in found.failures %}
<p>Not simulated: {{ line }}</p>
{% endfor %}
</main>
</body>
</html>
"""


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
    from plotly.offline import get_plotlyjs

    environment = environment_of("scenetruth.pages")
    tables = []
    for quantity in DRAWN:
        parts = found.of(quantity, region)
        if not parts:
            continue
        total = found.total(quantity, region)
        rows = [
            [
                one.title,
                one.size,
                number(one.figure),
                number(one.predicted),
                number(one.drawn),
                number(one.simulated),
                f"{100 * one.seen:.0f} %" if math.isfinite(one.seen) else "–",
            ]
            for one in parts
        ]
        rows.append(["root of the sum of squares", "", number(total.parts), "", "", "", ""])
        rows.append(["added up pixel by pixel", "", number(total.added), "", "", "", ""])
        rows.append(["everything on", "", "", "", "", number(total.simulated), f"{100 * total.seen:.0f} %"])
        tables.append({"title": f"{quantity.replace('_', ' ')}, {unit_words(total.unit)}", "rows": rows})
    text = environment.from_string(_TEMPLATE).render(
        found=found,
        place=_PLACES.get(region, f"the interior of {region.removeprefix('object_')}"),
        words=found.words(region),
        waterfalls=waterfall_html(found, region),
        tables=tables,
        plotly=get_plotlyjs(),
    )
    path = folder / PAGE
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    return path

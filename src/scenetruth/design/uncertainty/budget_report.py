"""Report of an uncertainty budget: waterfall charts, and a self-contained HTML page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.design.uncertainty.simulation_runs import GROWTH
from scenetruth.glossary import define_terms
from scenetruth.html import Chart, HtmlCell, HtmlTable, plotly_script, script_json, template_environment
from scenetruth.number_format import format_two_digits, format_unit
from scenetruth.output import write_atomically
from scenetruth.scoring.quantities import get_title

if TYPE_CHECKING:
    from scenetruth.design.uncertainty.uncertainty_budget import Budget

__all__ = [
    "SHOWN_QUANTITIES",
    "WaterfallBar",
    "compute_bars",
    "format_contribution",
    "make_waterfalls",
    "write_page",
    "write_waterfall",
]


SHOWN_QUANTITIES = ("depth", "velocity_x", "velocity_y", "velocity_z", GROWTH)
"""Quantities with a chart."""
COLOURS = {"images": "#0072B2", "stage": "#D55E00", "calibration": "#009E73", "surface": "#CC79A7"}
"""Colour-blind-safe colours by group of sources (M. Okabe and K. Ito, 2008)."""
_TITLES = {"images": "images", "stage": "stage and shutter", "calibration": "calibration", "surface": "surface, method"}
_LEAST = 1e-3  # smaller fractions of the sum of squares are combined in one bar


@dataclass(frozen=True)
class WaterfallBar:
    """A waterfall bar from the root sum of squares before to that with a contribution; no group for several sources."""

    title: str
    group: str
    start: float
    end: float
    value: float
    simulated: bool


def compute_bars(found: Budget, quantity: str, region: str = "interior") -> list[WaterfallBar]:
    """Return the bars of a waterfall in descending order; small contributions are combined in one bar."""
    from scenetruth.design.uncertainty.source import all_sources

    parts = [one for one in found.contributions(quantity, region) if math.isfinite(one.value) and one.value > 0]
    whole = sum(one.value**2 for one in parts)
    steps: list[WaterfallBar] = []
    before, small = 0.0, 0.0
    for one in parts:
        if one.value**2 < _LEAST * whole and steps:
            small += one.value**2
            continue
        after = before + one.value**2
        group = all_sources()[one.cause].group
        sure = math.isfinite(one.simulated) or group == "surface"
        steps.append(WaterfallBar(one.title, group, math.sqrt(before), math.sqrt(after), one.value, sure))
        before = after
    if small > 0:
        count = len(parts) - len(steps)
        title = f"{count} smaller contribution{'s' if count > 1 else ''}"
        steps.append(WaterfallBar(title, "", math.sqrt(before), math.sqrt(before + small), math.sqrt(small), False))
    return steps


def _finite(*values: float) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _shown_quantities(found: Budget, region: str) -> list[str]:
    there = {one.quantity for one in found.totals if one.region == region}
    return [quantity for quantity in SHOWN_QUANTITIES if quantity in there and compute_bars(found, quantity, region)]


def _heading(quantity: str) -> str:
    return "Growth" if quantity == GROWTH else get_title(quantity)


def write_waterfall(found: Budget, path: Path, region: str = "interior") -> None:
    """Draw the waterfall charts of depth, motion and growth to a PNG file."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    drawn = _shown_quantities(found, region)
    steps = {quantity: compute_bars(found, quantity, region) for quantity in drawn}
    heights = [len(one) + 3.2 for one in steps.values()]
    figure = Figure(figsize=(9.0, 0.34 * sum(heights) + 0.7), layout="constrained", dpi=110)
    axes = figure.subplots(max(len(drawn), 1), 1, squeeze=False, height_ratios=heights or None)[:, 0]
    for axis, quantity in zip(axes, drawn, strict=False):
        _draw(axis, found, quantity, steps[quantity], region)
    patches = [Patch(color=colour, label=_TITLES[group]) for group, colour in COLOURS.items()]
    patches.append(Patch(color="#888888", alpha=0.45, label="pale: predicted, not simulated"))
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), fontsize=9, frameon=False)
    with write_atomically(path, overwrite=True) as partial:
        figure.savefig(partial, format="png")


def _draw(axis: Any, found: Budget, quantity: str, steps: list[WaterfallBar], region: str) -> None:
    from matplotlib.ticker import MaxNLocator

    total, last = found.combined(quantity, region), len(steps)
    bars = [(step.start, step.end, COLOURS.get(step.group, "#888888"), step.simulated, step.value) for step in steps]
    for place, (start, end, colour, sure, figure) in enumerate(
        [*bars, (0.0, total.root_sum_square, "#444444", True, total.root_sum_square)]
    ):
        axis.barh(place, end - start, left=start, color=colour, alpha=1.0 if sure else 0.45, height=0.7)
        # On top of lines and bars.
        axis.annotate(
            format_two_digits(figure),
            (end, place),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            zorder=5,
        )
    if math.isfinite(total.simulated):
        axis.axvline(total.simulated, color="black", linestyle="--", linewidth=1)
        axis.annotate(
            f"all sources, simulated: {format_two_digits(total.simulated)}",
            (total.simulated, 1.0),
            (0, 3),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="right",
            fontsize=9,
        )
    axis.set_yticks(range(last + 1), [*(step.title for step in steps), "root sum of squares"], fontsize=9)
    axis.invert_yaxis()
    axis.set_xlim(0, 1.16 * max(total.root_sum_square, total.simulated if math.isfinite(total.simulated) else 0))
    axis.xaxis.set_major_locator(MaxNLocator(6))
    axis.set_title(f"{_heading(quantity)}, {format_unit(total.unit)}", loc="left", fontsize=11, pad=14)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def make_waterfalls(found: Budget, region: str = "interior") -> list[Chart]:
    """Return the waterfalls of depth, motion and growth as charts of a page."""
    return [_make_chart(found, quantity, region) for quantity in _shown_quantities(found, region)]


def _make_chart(found: Budget, quantity: str, region: str) -> Chart:
    total, steps = found.combined(quantity, region), compute_bars(found, quantity, region)
    unit = format_unit(total.unit)
    # The simulation with all sources is a bar of its own: a line across the others would cover their numbers.
    sums = {"root sum of squares": total.root_sum_square}
    sums |= {"all sources, simulated": total.simulated} if math.isfinite(total.simulated) else {}
    titles, figures = [*(step.title for step in steps), *sums], [*(step.value for step in steps), *sums.values()]
    colours = [*(COLOURS.get(step.group, "#888888") for step in steps), *("#444444", "#777777")[: len(sums)]]
    bar: dict[str, Any] = {
        "type": "bar",
        "orientation": "h",
        "y": titles,
        "x": [*(step.end - step.start for step in steps), *sums.values()],
        "base": [*(step.start for step in steps), *(0.0 for _ in sums)],
        "marker": {
            "color": colours,
            "opacity": [*(1.0 if step.simulated else 0.45 for step in steps), *(1.0 for _ in sums)],
        },
        "text": [format_two_digits(one) for one in figures],
        "textposition": "outside",
        "cliponaxis": False,
        "customdata": [
            f"{format_two_digits(step.value)} {unit}, {'simulated' if step.simulated else 'predicted'}"
            for step in steps
        ]
        + [f"{format_two_digits(value)} {unit}" for value in sums.values()],
        "hovertemplate": "%{y}: %{customdata}<extra></extra>",
        "showlegend": False,
    }
    layout: dict[str, Any] = {
        "title": {"text": f"{_heading(quantity)}, {unit}"},
        "yaxis": {"autorange": "reversed", "automargin": True},
        # Space for numbers next to the bars, also on small screens.
        "xaxis": {
            "range": [0, 1.5 * max([total.root_sum_square, *_finite(total.simulated)])],
            "exponentformat": "none",
        },
        "height": 150 + 32 * len(titles),
        "margin": {"l": 10, "r": 20, "t": 40, "b": 30},
    }
    line = "; ".join(f"{step.title} {format_two_digits(step.value)}" for step in steps)
    alt = f"{_heading(quantity)}, {unit}: {line}; combined {format_two_digits(total.root_sum_square)}."
    return Chart(f"waterfall-{quantity}", alt, [bar], layout)


PAGE_NAME = "index.html"

_TEMPLATE = """{% extends "page_with_charts.html.j2" %}
{% from "parts.html.j2" import plots, sortable %}
{% block title %}Uncertainty budget: {{ found.scene or found.method }}{% endblock %}
{% block style %}
tfoot td { color: var(--soft); }
.answer { border-left: 4px solid var(--accent); padding: .1rem 0 .1rem .8rem; }
.charts { grid-template-columns: 1fr; }
.chart { min-height: 0; }
.legend span { white-space: nowrap; margin-right: 1.2em; }
.legend i { display: inline-block; width: .8em; height: .8em; margin-right: .4em; }
{% endblock %}
{% block header %}
<h1>Uncertainty budget{{ ": " if found.scene }}{{ found.scene }}</h1>
{% endblock %}
{% block main %}
{% for line in words %}
<p class="answer">{{ line }}</p>
{% else %}
<p>No quantity has a valid pixel in {{ place }}: a budget needs larger images, or another region.</p>
{% endfor %}
<p class="soft">Method: {{ found.method }}; {{ found.draws }} seed{{ "s" if found.draws > 1 }};
RMS over {{ place }}.</p>
<p>A contribution is the change of the estimate, pixel by pixel, when one source alone is switched on. Contributions add
as squares: every bar extends from the root sum of squares before it to that with it. Method bias is the error with
ideal images, without the parts that slanted and curved surfaces explain.{% if pale %} Pale bars are predicted, full
bars simulated.{% endif %}</p>
<p class="legend">{% for colour, group in legend %}<span><i style="background: {{ colour }}"></i>{{ group }}</span>
{% endfor %}</p>
{{ plots(waterfalls) }}
<h2>All contributions</h2>
<p>The signed sum per pixel is the RMS of the sum of all contributions with their signs. It differs from the root sum of
squares where biases cancel or add up. A contribution is simulated where a simulation exists, and predicted otherwise;
slanted and curved surfaces contribute the part of the error with ideal images that correlates with their prediction,
which may be larger or smaller.</p>
{% for table in tables %}
{{ sortable(table) }}
{% endfor %}
{% for line in found.failures %}
<p>Not simulated: {{ line }}</p>
{% endfor %}
{% endblock %}
"""

_FOR_SEEDS = "predicted for seeds"
_COLUMNS = ("source", "magnitude", "contribution", "predicted", _FOR_SEEDS, "simulated", "valid pixels")
_REGION_TITLES = {"interior": "the interior", "all": "the visible surface"}


def write_page(found: Budget, folder: Path, region: str = "interior") -> Path:
    """Write the HTML page of a budget."""
    environment = template_environment("scenetruth")
    tables = []
    for quantity in SHOWN_QUANTITIES:
        parts = found.contributions(quantity, region)
        if not parts:
            continue
        total = found.combined(quantity, region)
        rows = [
            {
                "source": HtmlCell(one.title),
                "magnitude": HtmlCell(one.size),  # magnitudes have different units and sort as text
                "contribution": _cell(one.value, total.root_sum_square),
                "predicted": _cell(one.predicted, total.root_sum_square),
                _FOR_SEEDS: _cell(one.predicted_for_seeds, total.root_sum_square),
                "simulated": _cell(one.simulated, total.root_sum_square),
                "valid pixels": _share(one.valid_fraction),
            }
            for one in parts
        ]
        sums = [
            {"source": "root sum of squares", "contribution": format_two_digits(total.root_sum_square)},
            {"source": "signed sum per pixel", "contribution": format_two_digits(total.signed_sum)},
            {
                "source": "all sources",
                "simulated": format_two_digits(total.simulated),
                "valid pixels": _share(total.valid_fraction).text,
            },
        ]
        of_seeds = any(math.isfinite(one.predicted_for_seeds) for one in parts)
        columns = [name for name in _COLUMNS if name != _FOR_SEEDS or of_seeds]
        lines = [[row[name] for name in columns] for row in rows]
        foot = [[HtmlCell(row.get(name, "")) for name in columns] for row in sums]
        caption = f"{_heading(quantity)}, {format_unit(total.unit)}"
        tables.append(HtmlTable(f"parts-{quantity}", caption, columns, lines, foot=foot))
    waterfalls = make_waterfalls(found, region)
    bars = [bar for quantity in _shown_quantities(found, region) for bar in compute_bars(found, quantity, region)]
    text = environment.from_string(_TEMPLATE).render(
        found=found,
        place=_REGION_TITLES.get(region, f"the interior of {region.removeprefix('object_')}"),
        words=found.summary(region).splitlines(),
        waterfalls=waterfalls,
        legend=[
            (colour, _TITLES[group]) for group, colour in COLOURS.items() if any(bar.group == group for bar in bars)
        ],
        pale=not all(bar.simulated for bar in bars),
        tables=tables,
        plotly=plotly_script(),
        charts=script_json({one.name: {"data": one.data, "layout": one.layout} for one in waterfalls}),
    )
    path = folder / PAGE_NAME
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(define_terms(text), encoding="utf-8")
    return path


def format_contribution(value: float, combined: float) -> str:
    """Return a contribution as text; what rounding leaves of a contribution that is zero is shown as zero."""
    return "0" if abs(value) < _ROUNDING * combined else format_two_digits(value)


def _cell(value: float, combined: float) -> HtmlCell:
    return HtmlCell(format_contribution(value, combined), value)


_ROUNDING = 1e-6


def _share(value: float) -> HtmlCell:
    return HtmlCell(f"{100 * value:.0f} %" if math.isfinite(value) else "–", value)

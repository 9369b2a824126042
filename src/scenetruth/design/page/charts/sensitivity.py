"""Charts of what parameters do: what 10 % more and less of each costs, and their shares of the variance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scenetruth.design.optimise.result import Design, Objective, Sensitivity
from scenetruth.design.page.charts.way import finite
from scenetruth.design.page.words import estimate, signed_percent
from scenetruth.pages.charts import COLOURS, Chart

__all__ = ["sensitivity_charts"]

_MOST_BARS = 20
_PALE = ("#8cc1e0", "#f0b28f")
"""The first colours of charts, paler."""
_BESIDE = 0.3
"""Share of the bars' span beside them."""
_BAR_PX, _AROUND_PX = 52, 150
"""Height of two bars, and of what is around all of them."""


def sensitivity_charts(design: Design) -> list[Chart]:
    """Return what each parameter does to each objective: 10 % more and less of it, and shares of the variance.

    Parameters
    ----------
    design
        The design.
    """
    charts = []
    for place, objective in enumerate(design.objectives):
        own = [one for one in design.sensitivities if one.objective == objective.title]
        steps = [one for one in own if math.isfinite(one.ten_percent)]
        shares = [one for one in own if math.isfinite(one.sobol_total)]
        charts += [_ten_percent(place, objective, steps)] if steps else []
        charts += [_sobol(place, objective, shares)] if shares else []
    return charts


def _ten_percent(place: int, objective: Objective, own: Sequence[Sensitivity]) -> Chart:
    """Return bars of what 10 % more and less of each parameter does, the largest on top."""
    shown = sorted(own, key=lambda one: abs(one.ten_percent))[-_MOST_BARS:]
    data = []
    for name, changes, colours in (
        ("10 % less", [one.ten_percent_less for one in shown], _PALE),
        ("10 % more", [one.ten_percent for one in shown], COLOURS),
    ):
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": name,
                "x": [finite(100 * one) for one in changes],
                "y": [_folded(one.parameter) for one in shown],
                "text": [signed_percent(one) for one in changes],
                "textposition": "auto",
                "insidetextanchor": "middle",
                "cliponaxis": False,
                # Less is better.
                "marker": {"color": [colours[1] if one > 0 else colours[0] for one in changes]},
                "hovertemplate": f"{name} of %{{y}}: %{{text}}<extra></extra>",
            }
        )
    # Room for words beside short bars.
    ends = [one for each in shown for one in (each.ten_percent, each.ten_percent_less) if math.isfinite(one)]
    reach = [100 * end(0.0, *ends) for end in (min, max)]
    spare = _BESIDE * max(reach[1] - reach[0], 1.0)
    key = "full: 10 % more; pale: less; blue is better"
    layout = {
        "title": {"text": f"{objective.title}: ±10 %<br><sub>{key}</sub>"},
        "xaxis": {"title": {"text": "change, %"}, "range": [reach[0] - spare, reach[1] + spare], "automargin": True},
        "yaxis": {"automargin": True},
        "barmode": "group",
        "showlegend": False,
        "height": _AROUND_PX + _BAR_PX * len(shown),
    }
    told = "; ".join(
        f"{one.parameter} {signed_percent(one.ten_percent)} ({signed_percent(one.ten_percent_less)})"
        for one in reversed(shown)
    )
    words = f"Change of {objective.title} for 10 % more (less) of a parameter: {told}."
    return Chart(f"ten-percent-{place}", words, data, layout)


def _sobol(place: int, objective: Objective, own: Sequence[Sensitivity]) -> Chart:
    """Return bars of the shares of variance, with their intervals."""
    shown = sorted(own, key=lambda one: one.sobol_total)[-_MOST_BARS:]
    data: list[dict[str, Any]] = []
    for name, field, colour in (
        ("with interactions", "sobol_total", COLOURS[4]),
        ("alone", "sobol_first", COLOURS[0]),
    ):
        found = [(getattr(one, field), getattr(one, f"{field}_half")) for one in shown]
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": name,
                "x": [finite(index) for index, _ in found],
                "y": [_folded(one.parameter) for one in shown],
                "error_x": {"type": "data", "array": [finite(half) for _, half in found], "thickness": 1, "width": 2},
                # What is not known is pale.
                "marker": {"color": colour, "opacity": [1.0 if abs(a) >= b else 0.4 for a, b in found]},
                "customdata": [estimate(*one, each.sobol_samples) for one, each in zip(found, shown, strict=True)],
                "hovertemplate": f"%{{y}}, {name}: %{{customdata}}<extra></extra>",
            }
        )
    key = f"Sobol' indices from {shown[-1].sobol_samples} samples; bars: 95 %"
    layout = {
        "title": {"text": f"{objective.title}: variance<br><sub>{key}</sub>"},
        "xaxis": {
            "title": {"text": "share of the variance"},
            "rangemode": "tozero",
            "automargin": True,
        },
        "yaxis": {"automargin": True},
        "barmode": "group",
        "height": _AROUND_PX + 40 + _BAR_PX * len(shown),
        "legend": {"traceorder": "reversed"},
    }
    told = "; ".join(
        f"{one.parameter} {estimate(one.sobol_total, one.sobol_total_half, one.sobol_samples)}"
        for one in reversed(shown)
    )
    return Chart(f"sobol-{place}", f"Total Sobol' indices of {objective.title}: {told}.", data, layout)


def _folded(path: str) -> str:
    """Break a long path at a dot, so that there is room for its bar."""
    if len(path) <= 18 or "." not in path:
        return path
    head, _, last = path.rpartition(".")
    return f"{head}.<br>{last}"

"""Charts of what parameters do: what 10 % more of each costs, and their shares of the variance."""

from __future__ import annotations

import math
from collections.abc import Sequence

from scenetruth.comparison.page.charts import COLOURS, Chart
from scenetruth.design.optimise.result import Design, Objective, Sensitivity
from scenetruth.design.page.charts.way import finite
from scenetruth.design.page.words import number, signed_percent

__all__ = ["sensitivity_charts"]

_MOST_BARS = 20
_BESIDE = 0.16
"""Share of the bars' span beside them."""
_BAR_PX, _AROUND_PX = 38, 150
"""Height of a bar, and of what is around all of them."""


def sensitivity_charts(design: Design) -> list[Chart]:
    """Return what each parameter does to each objective: 10 % more of it, and shares of the variance.

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
    """Return bars of what 10 % more of each parameter does, the largest on top."""
    shown = sorted(own, key=lambda one: abs(one.ten_percent))[-_MOST_BARS:]
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "x": [100 * one.ten_percent for one in shown],
            "y": [_folded(one.parameter) for one in shown],
            "text": [signed_percent(one.ten_percent) for one in shown],
            "textposition": "auto",
            "cliponaxis": False,
            # Less is better.
            "marker": {"color": [COLOURS[0] if one.ten_percent <= 0 else COLOURS[1] for one in shown]},
            "hovertemplate": "10 % more of %{y}: %{text}<extra></extra>",
        }
    ]
    # Room for words beside short bars.
    reach = [100 * end(0.0, *(one.ten_percent for one in shown)) for end in (min, max)]
    spare = _BESIDE * max(reach[1] - reach[0], 1.0)
    layout = {
        "title": {"text": f"10 % more of each parameter<br><sub>{objective.title}: blue is better, red is worse</sub>"},
        "xaxis": {"title": {"text": "change, %"}, "range": [reach[0] - spare, reach[1] + spare], "automargin": True},
        "yaxis": {"automargin": True},
        "showlegend": False,
        "height": _AROUND_PX + _BAR_PX * len(shown),
    }
    told = "; ".join(f"{one.parameter} {signed_percent(one.ten_percent)}" for one in reversed(shown))
    return Chart(
        f"ten-percent-{place}", f"Change of {objective.title} for 10 % more of a parameter: {told}.", data, layout
    )


def _sobol(place: int, objective: Objective, own: Sequence[Sensitivity]) -> Chart:
    """Return bars of the shares of variance."""
    shown = sorted(own, key=lambda one: one.sobol_total)[-_MOST_BARS:]
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "name": name,
            "x": [finite(getattr(one, field)) for one in shown],
            "y": [_folded(one.parameter) for one in shown],
            "marker": {"color": colour},
        }
        for name, field, colour in (
            ("with interactions", "sobol_total", COLOURS[4]),
            ("alone", "sobol_first", COLOURS[0]),
        )
    ]
    layout = {
        "title": {"text": f"Share of the variance over all ranges<br><sub>{objective.title}: Sobol' indices</sub>"},
        "xaxis": {"title": {"text": "share of the variance"}, "rangemode": "tozero", "automargin": True},
        "yaxis": {"automargin": True},
        "barmode": "group",
        "height": _AROUND_PX + 40 + _BAR_PX * len(shown),
        "legend": {"traceorder": "reversed"},
    }
    told = "; ".join(f"{one.parameter} {number(one.sobol_total, 2)}" for one in reversed(shown))
    return Chart(f"sobol-{place}", f"Total Sobol' indices of {objective.title}: {told}.", data, layout)


def _folded(path: str) -> str:
    """Break a long path at a dot, so that there is room for its bar."""
    if len(path) <= 18 or "." not in path:
        return path
    head, _, last = path.rpartition(".")
    return f"{head}.<br>{last}"

"""Charts of the front: each objective over each other one, or a single one over what matters most to it."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

from scenetruth.design.optimise.result import Design, Rig
from scenetruth.design.page.charts.traces import cloud, joins, predicted, simulated, star
from scenetruth.design.page.charts.way import Way, axis_of, wanted_on
from scenetruth.design.page.words import number
from scenetruth.pages.charts import Chart

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["front_charts"]

_MOST_PAIRS, _MOST_SCREENED = 6, 1000


def front_charts(design: Design) -> list[Chart]:
    """Return the charts of the front.

    Parameters
    ----------
    design
        The design.
    """
    ways = [Way(objective.title, objective) for objective in design.objectives]
    if len(ways) == 1:
        parameter = _most_telling(design)
        return [] if parameter is None else [_chart(design, Way(parameter), ways[0], "front-0")]
    pairs = list(combinations(range(len(ways)), 2))[:_MOST_PAIRS]
    return [_chart(design, ways[one], ways[other], f"front-{one}-{other}") for one, other in pairs]


def _chart(design: Design, x: Way, y: Way, name: str) -> Chart:
    """Return rigs by two figures."""
    is_front = x.objective is not None
    held, best = _held(design.screened), design.recommended
    rigs = sorted(design.rigs, key=x.predicted)
    confirmed = [rig for rig in rigs if x.simulated(rig) is not None and y.simulated(rig) is not None]
    # In two of several objectives, the front is no line that goes down; of a single one it is a point.
    numbers = {rig.number for rig in design.front} if is_front else set()
    first = [rig for rig in rigs if rig.number in numbers]
    behind = [rig for rig in rigs if rig.number not in numbers]
    data = [cloud(x.screened(held), y.screened(held))]
    data += [predicted(first, x, y, joined=len(design.objectives) == 2)] if first else []
    data += [predicted(behind, x, y, joined=None)] if behind else []
    data += [joins(confirmed, x, y), simulated(confirmed, x, y)] if confirmed else []
    data.append(star(best, x, y))
    axes, shapes, signs = {}, [], []
    for axis, way in (("x", x), ("y", y)):
        figures = [found for rig in confirmed if (found := way.simulated(rig)) is not None]
        ends = [end for one in figures for end in (one.low, one.high) if math.isfinite(end)]
        axes[f"{axis}axis"] = axis_of(way, [value for trace in data for value in trace[axis]], ends)
        line, words = wanted_on(way, axis, axes[f"{axis}axis"])
        shapes += line
        signs += words
    title = f"{y.name}<br><sub>over {x.name}</sub>"
    layout = {"title": {"text": title}, "shapes": shapes, "annotations": signs, **axes}
    ends_of = [f"{number(x.predicted(rig))} and {number(y.predicted(rig))}" for rig in (rigs[0], rigs[-1])]
    told = (
        f"{y.title} over {x.title}; less is better{' in both' if is_front else ''}. Predictions of {len(rigs)} rigs, "
        f"from {ends_of[0]} to {ends_of[1]}; {len(confirmed)} of them were simulated. Recommended: "
        f"rig {best.number} with {number(x.predicted(best))} and {number(y.predicted(best))}."
    )
    return Chart(name, told, data, layout)


def _held(screened: pd.DataFrame) -> pd.DataFrame:
    """Return predictions within all constraints, evenly thinned out if they are many."""
    held = screened[screened["holds"].astype(bool)]
    return held.iloc[:: max(1, -(-len(held) // _MOST_SCREENED))]


def _most_telling(design: Design) -> str | None:
    """Return the parameter that does most to the only objective, of those that are numbers; None if there are none."""
    worth = {
        path: 0.0
        for path in design.recommended.parameters
        if path in design.screened and all(_is_number(rig.parameters.get(path)) for rig in _rigs(design))
    }
    for one in design.sensitivities:
        if one.parameter in worth and one.objective == design.objectives[0].title:
            told = [abs(each) for each in (one.sobol_total, one.morris_mu_star, one.ten_percent) if math.isfinite(each)]
            worth[one.parameter] = told[0] if told else 0.0
    return max(worth, key=lambda path: worth[path], default=None)


def _rigs(design: Design) -> list[Rig]:
    return list(design.rigs)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

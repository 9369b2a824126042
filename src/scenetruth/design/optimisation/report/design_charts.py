"""Charts of a design for plotly.js: the Pareto front and the sensitivities."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from scenetruth.design.optimisation.design_records import Objective, PredictionInterval, RigDesign, Sensitivity
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.parameter_words import describe_parameter, label_parameter, title_parameter
from scenetruth.html import COLOURS, Chart
from scenetruth.number_format import (
    format_estimate,
    format_interval,
    format_length,
    format_measured,
    format_number,
    format_signed_percent,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["AxisSpec", "build_axis", "build_front_charts", "build_sensitivity_charts"]


_WIDE = 8.0  # ratio of the largest to the smallest value from which an axis is logarithmic
_BEYOND = 3.0  # largest extension of an axis by error bars: a factor, or a multiple of the span of the points
_FEW_DECADES = 2.5
_SPARE = 0.05
_LEAST = 1e-30  # smallest value on a logarithmic axis
_ROUNDING = 1e-12


@dataclass(frozen=True)
class AxisSpec:
    """Quantity of an axis: an objective, or a parameter (``objective=None``); a column of the table of evaluations."""

    name: str
    objective: Objective | None = None

    @property
    def title(self) -> str:
        """Title of the axis."""
        return (
            label_parameter(self.name)
            if self.objective is None
            else f"{self.name}: {self.objective.statistic_title}, {self.objective.unit}"
        )

    def predicted(self, rig: RigDesign) -> float:
        """Return the position of a predicted rig."""
        return float(rig.parameters[self.name] if self.objective is None else rig.predicted[self.name])

    def simulated(self, rig: RigDesign) -> PredictionInterval | None:
        """Return the position of a simulated rig; None without simulations."""
        if self.objective is None:
            return PredictionInterval(self.predicted(rig), math.nan, math.nan, 0)
        return rig.simulated.get(self.name)

    def screened(self, table: pd.DataFrame) -> list[float]:
        """Return the positions of all evaluations; NaN for non-numeric values."""
        import pandas as pd

        return [float(value) for value in pd.to_numeric(table[self.name], errors="coerce")]


def build_axis(way: AxisSpec, points: Sequence[float | None], ends: Sequence[float | None]) -> dict[str, Any]:
    """Return an axis that includes all points, and the ends of error bars up to a limited extension."""
    axis: dict[str, Any] = {"title": {"text": way.title}, "automargin": True}
    known = [value for value in points if value is not None]
    if way.objective is not None and way.objective.wanted is not None:
        known.append(way.objective.wanted)
    if not known:
        return {**axis, "type": "linear"}
    low, high = min(known), max(known)
    bars = [value for value in ends if value is not None]
    if low > _LEAST and (high > _WIDE * low or any(not low / 2 < value < 2 * high for value in bars)):
        first = min([low, *(max(value, low / _BEYOND) for value in bars)])
        last = max([high, *(min(value, high * _BEYOND) for value in bars)])
        spare = _SPARE * max(math.log10(last) - math.log10(first), 0.1)
        span = [math.log10(first) - spare, math.log10(last) + spare]
        ticks = "D2" if span[1] - span[0] < _FEW_DECADES else 1  # short axes also have labels at 2 and 5
        return {**axis, "type": "log", "tickformat": "~g", "dtick": ticks, "range": span}
    nothing = max(_ROUNDING * max(abs(low), abs(high)), _LEAST)  # differences due to rounding are ignored
    wide = high - low if high - low > nothing else abs(high) if abs(high) > nothing else 1.0
    first = min([low, *(max(value, low - _BEYOND * wide) for value in bars)])
    last = max([high, *(min(value, high + _BEYOND * wide) for value in bars)])
    spare = _SPARE * (last - first if last - first > nothing else wide)
    return {**axis, "type": "linear", "exponentformat": "power", "range": [first - spare, last + spare]}


def build_target_line(
    way: AxisSpec, axis: str, drawn: Mapping[str, Any]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the line and the annotation of a target; empty lists without a target."""
    wanted = None if way.objective is None else way.objective.wanted
    if way.objective is None or wanted is None:
        return [], []
    other = "y" if axis == "x" else "x"
    shape = {
        "type": "line",
        f"{axis}0": wanted,
        f"{axis}1": wanted,
        f"{other}0": 0,
        f"{other}1": 1,
        f"{other}ref": "paper",
        "line": {"color": "#009E73", "width": 1.5, "dash": "dash"},
    }
    words = {
        # Positions of annotations on logarithmic axes are logarithms.
        axis: math.log10(wanted) if drawn["type"] == "log" else wanted,
        other: 1,
        f"{other}ref": "paper",
        f"{other}anchor": "top" if axis == "x" else "right",
        f"{axis}anchor": "left" if axis == "x" else "bottom",
        "text": f"target: {format_length(wanted)} {way.objective.unit}",
        "showarrow": False,
        "bgcolor": "rgba(255,255,255,0.85)",
    }
    return [shape], [words]


def finite_or_none(value: float) -> float | None:
    """Return a number, or None if it is not finite, as JSON requires."""
    return value if math.isfinite(value) else None


_GREY, _INK = "#9aa5b1", "#1b2430"
_BLUE, _RED, _GREEN = COLOURS[:3]


def trace_screening(x: Sequence[float], y: Sequence[float]) -> dict[str, Any]:
    """Return the trace of all feasible evaluations, as faint points."""
    known = [(a, b) for a, b in zip(x, y, strict=True) if math.isfinite(a) and math.isfinite(b)]
    return {
        "name": "evaluated, feasible",
        "x": [a for a, _ in known],
        "y": [b for _, b in known],
        "mode": "markers",
        "marker": {"color": _GREY, "size": 4, "opacity": 0.5},
        "hoverinfo": "skip",
    }


def trace_predictions(rigs: Sequence[RigDesign], x: AxisSpec, y: AxisSpec, *, joined: bool | None) -> dict[str, Any]:
    """Return the trace of predictions of the front, joined by a line or not, or of alternatives (``joined=None``)."""
    return {
        "name": "alternatives, predicted" if joined is None else "front, predicted",
        "x": [finite_or_none(x.predicted(rig)) for rig in rigs],
        "y": [finite_or_none(y.predicted(rig)) for rig in rigs],
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


def trace_simulations(rigs: Sequence[RigDesign], x: AxisSpec, y: AxisSpec) -> dict[str, Any]:
    """Return the trace of simulated rigs with prediction intervals."""
    trace: dict[str, Any] = {
        "name": "simulated, 95 %",
        "mode": "markers",
        "marker": {"color": _RED, "symbol": "diamond", "size": 9},
        **_hover(rigs),
    }
    for axis, way in (("x", x), ("y", y)):
        figures = [found for rig in rigs if (found := way.simulated(rig)) is not None]
        trace[axis] = [finite_or_none(one.value) for one in figures]
        if any(math.isfinite(one.pi_low) for one in figures):
            trace[f"error_{axis}"] = {
                "type": "data",
                "symmetric": False,
                "array": [finite_or_none(one.pi_high - one.value) for one in figures],
                "arrayminus": [finite_or_none(one.value - one.pi_low) for one in figures],
                "thickness": 1,
                "color": _RED,
            }
    return trace


def trace_discrepancies(rigs: Sequence[RigDesign], x: AxisSpec, y: AxisSpec) -> dict[str, Any]:
    """Return the trace of thin lines from predictions to simulations."""
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
            trace[axis] += [
                finite_or_none(way.predicted(rig)),
                None if found is None else finite_or_none(found.value),
                None,
            ]
    return trace


def trace_recommended(rig: RigDesign, x: AxisSpec, y: AxisSpec) -> dict[str, Any]:
    """Return the trace of the recommended rig."""
    return {
        "name": f"recommended: rig {rig.number}",
        "x": [finite_or_none(x.predicted(rig))],
        "y": [finite_or_none(y.predicted(rig))],
        "mode": "markers",
        "marker": {"color": _GREEN, "symbol": "star", "size": 15, "line": {"color": _INK, "width": 1}},
        **_hover([rig]),
    }


def _hover(rigs: Sequence[RigDesign]) -> dict[str, Any]:
    return {"customdata": [_hover_text(rig) for rig in rigs], "hovertemplate": "%{customdata}<extra></extra>"}


def _hover_text(rig: RigDesign) -> str:
    lines = [f"<b>Rig {rig.number}</b>"]
    for title, value in rig.predicted.items():
        found = rig.simulated.get(title)
        text = f"{title}: predicted {format_number(value)}"
        if found is not None:
            between = format_interval(found.pi_low, found.pi_high)
            measured = format_measured(found.value, 0.5 * (found.pi_high - found.pi_low))
            text += f", simulated {measured}" + (f" ({between})" if between else "")
        lines.append(text)
    return "<br>".join([*lines, *(describe_parameter(path, value) for path, value in rig.parameters.items())])


_MOST_PAIRS, _MOST_SCREENED = 6, 1000


def build_front_charts(design: DesignResult) -> list[Chart]:
    """Return the charts of the front: pairs of objectives, or a single objective over a parameter."""
    ways = [AxisSpec(objective.title, objective) for objective in design.objectives]
    if len(ways) == 1:
        parameter = _most_influential(design)
        return [] if parameter is None else [_chart(design, AxisSpec(parameter), ways[0], "front-0")]
    pairs = list(combinations(range(len(ways)), 2))[:_MOST_PAIRS]
    return [_chart(design, ways[one], ways[other], f"front-{one}-{other}") for one, other in pairs]


def _chart(design: DesignResult, x: AxisSpec, y: AxisSpec, name: str) -> Chart:
    is_front = x.objective is not None
    held, best = _feasible(design.screened), design.recommended
    rigs = sorted(design.rigs, key=x.predicted)
    confirmed = [rig for rig in rigs if x.simulated(rig) is not None and y.simulated(rig) is not None]
    # For more than two objectives, the front is not a descending line; for a single objective, it is a point.
    numbers = {rig.number for rig in design.front} if is_front else set()
    first = [rig for rig in rigs if rig.number in numbers]
    behind = [rig for rig in rigs if rig.number not in numbers]
    data = [trace_screening(x.screened(held), y.screened(held))]
    data += [trace_predictions(first, x, y, joined=len(design.objectives) == 2)] if first else []
    data += [trace_predictions(behind, x, y, joined=None)] if behind else []
    data += [trace_discrepancies(confirmed, x, y), trace_simulations(confirmed, x, y)] if confirmed else []
    data.append(trace_recommended(best, x, y))
    axes, shapes, signs = {}, [], []
    for axis, way in (("x", x), ("y", y)):
        figures = [found for rig in confirmed if (found := way.simulated(rig)) is not None]
        ends = [end for one in figures for end in (one.pi_low, one.pi_high) if math.isfinite(end)]
        axes[f"{axis}axis"] = build_axis(way, [value for trace in data for value in trace[axis]], ends)
        line, words = build_target_line(way, axis, axes[f"{axis}axis"])
        shapes += line
        signs += words
    title = f"{y.name}<br><sub>over {x.name}</sub>"
    layout = {"title": {"text": title}, "shapes": shapes, "annotations": signs, **axes}
    ends_of = [
        f"{format_number(x.predicted(rig))} and {format_number(y.predicted(rig))}" for rig in (rigs[0], rigs[-1])
    ]
    text = (
        f"{y.title} over {x.title}; lower is better{' for both' if is_front else ''}. Predictions of {len(rigs)} rigs, "
        f"from {ends_of[0]} to {ends_of[1]}; {len(confirmed)} of them were simulated. Recommended: "
        f"rig {best.number} with {format_number(x.predicted(best))} and {format_number(y.predicted(best))}."
    )
    return Chart(name, text, data, layout)


def _feasible(screened: pd.DataFrame) -> pd.DataFrame:
    """Return the feasible evaluations, evenly thinned to at most 1000."""
    held = screened[screened["holds"].astype(bool)]
    return held.iloc[:: max(1, -(-len(held) // _MOST_SCREENED))]


def _most_influential(design: DesignResult) -> str | None:
    """Return the most influential numeric parameter of the first objective; None without numeric parameters."""
    worth = {
        path: 0.0
        for path in design.recommended.parameters
        if path in design.screened and all(_is_number(rig.parameters.get(path)) for rig in _rigs(design))
    }
    for one in design.sensitivities:
        if one.parameter in worth and one.objective == design.objectives[0].title:
            values = [
                abs(each) for each in (one.sobol_total, one.morris_mu_star, one.ten_percent) if math.isfinite(each)
            ]
            worth[one.parameter] = values[0] if values else 0.0
    return max(worth, key=lambda path: worth[path], default=None)


def _rigs(design: DesignResult) -> list[RigDesign]:
    return list(design.rigs)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


_MOST_BARS = 20
_PALE = ("#8cc1e0", "#f0b28f")  # pale variants of the first colours of charts
_BESIDE = 0.3  # margin of the axis for labels, as a fraction of the span of the bars
_BAR_PX, _AROUND_PX = 52, 150  # height of a pair of bars, and of the margins of the chart


def build_sensitivity_charts(design: DesignResult) -> list[Chart]:
    """Return charts of local sensitivities (±10 %) and of Sobol' indices for each objective."""
    charts = []
    for place, objective in enumerate(design.objectives):
        own = [one for one in design.sensitivities if one.objective == objective.title]
        steps = [one for one in own if math.isfinite(one.ten_percent)]
        shares = [one for one in own if math.isfinite(one.sobol_total)]
        charts += [_ten_percent(place, objective, steps)] if steps else []
        charts += [_sobol(place, objective, shares)] if shares else []
    return charts


def _ten_percent(place: int, objective: Objective, own: Sequence[Sensitivity]) -> Chart:
    """Return bars of the effect of ±10 % of each parameter, the largest at the top."""
    shown = sorted(own, key=lambda one: abs(one.ten_percent))[-_MOST_BARS:]
    data = []
    for name, changes, colours in (
        ("10 % decrease", [one.ten_percent_less for one in shown], _PALE),
        ("10 % increase", [one.ten_percent for one in shown], COLOURS),
    ):
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": name,
                "x": [finite_or_none(100 * one) for one in changes],
                "y": [_folded(title_parameter(one.parameter)) for one in shown],
                "text": [format_signed_percent(one) for one in changes],
                "textposition": "auto",
                "insidetextanchor": "middle",
                "cliponaxis": False,
                # Lower is better.
                "marker": {"color": [colours[1] if one > 0 else colours[0] for one in changes]},
                "hovertemplate": f"{name} of %{{y}}: %{{text}}<extra></extra>",
            }
        )
    # Margins for labels next to short bars.
    ends = [one for each in shown for one in (each.ten_percent, each.ten_percent_less) if math.isfinite(one)]
    reach = [100 * end(0.0, *ends) for end in (min, max)]
    spare = _BESIDE * max(reach[1] - reach[0], 1.0)
    key = "solid: 10 % increase; pale: decrease; blue: better"
    layout = {
        "title": {"text": f"{objective.title}: ±10 %<br><sub>{key}</sub>"},
        "xaxis": {"title": {"text": "change, %"}, "range": [reach[0] - spare, reach[1] + spare], "automargin": True},
        "yaxis": {"automargin": True},
        "barmode": "group",
        "showlegend": False,
        "height": _AROUND_PX + _BAR_PX * len(shown),
    }
    text = "; ".join(
        f"{title_parameter(one.parameter)} {format_signed_percent(one.ten_percent)} "
        f"({format_signed_percent(one.ten_percent_less)})"
        for one in reversed(shown)
    )
    words = f"Change of {objective.title} for an increase (decrease) of a parameter by 10 %: {text}."
    return Chart(f"ten-percent-{place}", words, data, layout)


def _sobol(place: int, objective: Objective, own: Sequence[Sensitivity]) -> Chart:
    shown = sorted(own, key=lambda one: one.sobol_total)[-_MOST_BARS:]
    data: list[dict[str, Any]] = []
    for name, field, colour in (
        ("total", "sobol_total", COLOURS[4]),
        ("first order", "sobol_first", COLOURS[0]),
    ):
        found = [(getattr(one, field), getattr(one, f"{field}_half")) for one in shown]
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": name,
                "x": [finite_or_none(index) for index, _ in found],
                "y": [_folded(title_parameter(one.parameter)) for one in shown],
                "error_x": {
                    "type": "data",
                    "array": [finite_or_none(half) for _, half in found],
                    "thickness": 1,
                    "width": 2,
                },
                # Insignificant indices are pale.
                "marker": {"color": colour, "opacity": [1.0 if abs(a) >= b else 0.4 for a, b in found]},
                "customdata": [
                    format_estimate(*one, each.sobol_samples) for one, each in zip(found, shown, strict=True)
                ],
                "hovertemplate": f"%{{y}}, {name}: %{{customdata}}<extra></extra>",
            }
        )
    key = f"Sobol' indices from {shown[-1].sobol_samples} samples; bars: 95 %"
    layout = {
        "title": {"text": f"{objective.title}: variance<br><sub>{key}</sub>"},
        "xaxis": {
            "title": {"text": "fraction of the variance"},
            "rangemode": "tozero",
            "automargin": True,
        },
        "yaxis": {"automargin": True},
        "barmode": "group",
        "height": _AROUND_PX + 40 + _BAR_PX * len(shown),
        "legend": {"traceorder": "reversed"},
    }
    text = "; ".join(
        f"{title_parameter(one.parameter)} {format_estimate(one.sobol_total, one.sobol_total_half, one.sobol_samples)}"
        for one in reversed(shown)
    )
    return Chart(f"sobol-{place}", f"Total Sobol' indices of {objective.title}: {text}.", data, layout)


def _folded(title: str) -> str:
    """Return a title with line breaks."""
    return "<br>".join(textwrap.wrap(title, 18))

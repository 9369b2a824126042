"""Charts of a benchmark, and the best methods of each case."""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenetruth.benchmark.benchmark_result import BenchmarkResult, RankedMethod, Ranking
from scenetruth.benchmark.cases.case import BOUND, COMMON_VALID, METHOD_VALID, BenchmarkRecord, Case
from scenetruth.html import COLOURS, Chart
from scenetruth.number_format import format_two_digits, format_unit
from scenetruth.scoring.quantities import get_title, get_units
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = [
    "RankDifference",
    "RankLeaders",
    "build_charts",
    "compute_rank_leaders",
    "describe_quantity",
    "describe_stated_uncertainty",
]


@dataclass(frozen=True)
class RankDifference:
    """A statistic for which external methods are better than the best built-in method, with their values."""

    kind: str
    title: str
    what: str
    others: Sequence[tuple[str, str]]
    own: Sequence[str]


@dataclass(frozen=True)
class RankLeaders:
    """Comparison of external and built-in methods.

    ``cases``: Number of cases with results of external methods; 0 if either group is empty.
    ``ahead``: Cases in which external methods are better, by the headline of the case.
    ``figures``: Number of values of external methods, for each quantity and each named level of a case.
    ``ahead_by_figures``: Those of them that are better than the built-in methods.
    ``best``: For each method, the titles of the cases in which it is the best of several.
    """

    own: Sequence[str]
    others: Sequence[str]
    cases: int
    ahead: Sequence[RankDifference]
    figures: int
    ahead_by_figures: Sequence[RankDifference]
    best: Sequence[tuple[str, Sequence[str]]]

    @property
    def lines(self) -> list[list[str]]:
        """Table lines of the values by which external methods are better: case, statistic, external, built-in."""
        return [
            [one.title, one.what, ", ".join(map(" ".join, one.others)), " ".join(one.own) or "–"]
            for one in self.ahead_by_figures
        ]


def compute_rank_leaders(found: BenchmarkResult) -> RankLeaders:
    """Return the comparison of external and built-in methods; equal values do not count as better."""
    others = [label for label in found.methods if label not in found.own]
    best = {label: list[str]() for label in found.methods}
    headlines, figures = found.headlines(), list(_figures(found))
    for one in headlines:
        first, *further = one.of_methods.items() or [("", math.nan)]
        if further and further[0][1] > first[1]:
            best[first[0]].append(one.case.title)
    entries, all_figures = ([one for one in some if _can_lead(one, found)] for some in (headlines, figures))
    return RankLeaders(
        found.own,
        others,
        len(entries),
        [ahead for one in entries if (ahead := _rank_difference(one, found)) is not None],
        len(all_figures),
        [ahead for one in all_figures if (ahead := _rank_difference(one, found)) is not None],
        [(label, titles) for label, titles in best.items() if titles],
    )


def _figures(found: BenchmarkResult) -> Iterator[RankedMethod]:
    """Yield all comparable values for each quantity, and for each level if levels have names."""
    standings = Ranking(found.rows, found.methods)
    for case in found.cases:
        kinds = [case.headline, *((name, "rmse") for name in (*case.quantities, "growth_rate_windowed"))]
        for quantity, statistic in dict.fromkeys(kinds):
            for value in case.labels() or [None]:
                one = standings.standing(case, quantity, statistic, value)
                if one is not None:
                    yield one


def _can_lead(one: RankedMethod, found: BenchmarkResult) -> bool:
    return bool(found.own) and any(label not in found.own for label in one.of_methods)


def _rank_difference(one: RankedMethod, found: BenchmarkResult) -> RankDifference | None:
    numbers = one.of_methods
    ours = [label for label in numbers if label in found.own]
    least = numbers[ours[0]] if ours else math.nan
    before = [label for label in numbers if label not in found.own and not numbers[label] >= least]
    if not before:
        return None
    title = f"{one.case.title}, {one.label}" if one.label else one.case.title
    what = f"{get_title(one.quantity)}, {STATISTIC_TITLES[one.statistic]}"
    entries = [(label, _words(one, found, numbers[label])) for label in before]
    return RankDifference(one.case.kind, title, what, entries, [ours[0], _words(one, found, least)] if ours else [])


def describe_quantity(one: RankedMethod) -> str:
    """Return case, quantity, statistic and unit of a value, for a table."""
    unit = f", {format_unit(one.unit)}".rstrip(", ")
    return f"{one.case.title}: {get_title(one.quantity)}, {STATISTIC_TITLES[one.statistic]}{unit}"


def _words(one: RankedMethod, found: BenchmarkResult, number: float) -> str:
    unit = "" if one.unit in ("", "1") else f" {one.unit}"
    if one.statistic.startswith("cutoff_period"):
        values = [row.level for row in found.rows if row.case == one.case.kind and math.isfinite(row.level)]
        # The cut-off period is outside the tested range.
        if number == 0:
            return f"under {min(values, default=math.nan):g}{unit}"
        if number == math.inf:
            return f"over {max(values, default=math.nan):g}{unit}"
    return f"{number:.3g}{unit}"


_DASHES = ("solid", "dash", "dot", "dashdot")
_SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")


def build_charts(found: BenchmarkResult, case: Case) -> list[Chart]:
    """Return the charts of a case: errors of its quantities, density, and stated uncertainty."""
    rows = [row for row in found.rows if row.case == case.kind]
    charts = []
    entries = dict.fromkeys([case.headline[0], *case.quantities, *_GROWTH])
    waves = {row.quantity for row in rows if row.statistic == "amplitude_ratio"}
    for quantity in entries:
        statistic = case.headline[1] if quantity == case.headline[0] else "rmse"
        # The cut-off periods are derived from this curve.
        chart = _curves(found, case, rows, quantity, "amplitude_ratio" if quantity in waves else statistic)
        if chart is not None:
            charts.append(chart)
    measured = case.headline[0] if case.headline[0] in case.quantities else case.quantities[0]
    density = _curves(found, case, rows, measured, "density")
    charts += [density] if density is not None else []
    charts += [chart for chart in (_confidence(found, case, rows, name) for name in _CONFIDENCE) if chart is not None]
    return charts


def _curves(
    found: BenchmarkResult, case: Case, rows: Sequence[BenchmarkRecord], quantity: str, statistic: str
) -> Chart | None:
    """Return a chart over the levels, with a line and confidence intervals for each method."""
    own, common = (
        {(row.method, row.level) for row in rows if _is(row, quantity, statistic, pixels)}
        for pixels in (METHOD_VALID, COMMON_VALID)
    )
    # If one method has no result, there are no pixels valid for all methods; each method then uses its valid pixels.
    pixels = COMMON_VALID if common and common == {one for one in own if one[0] != BOUND} else METHOD_VALID
    data = []
    for place, label in enumerate(found.methods):
        points = sorted(
            (row for row in rows if row.method == label and _is(row, quantity, statistic, pixels)), key=_value
        )
        if points:
            data.append(_line(case, label, place, points))
    if not data:
        return None
    bounds = sorted((row for row in rows if row.method == BOUND and row.quantity == quantity), key=_value)
    if bounds and statistic in ("rmse", "noise_std"):
        data.append(
            {
                "name": "Cramér-Rao bound",
                "x": [_place(case, row.level) for row in bounds],
                "y": [_finite(row.value) for row in bounds],
                "mode": "lines",
                "line": {"color": "#444444", "dash": "longdash", "width": 1.5},
            }
        )
    unit = {"density": ", %", "amplitude_ratio": ""}.get(statistic, f", {format_unit(get_units(quantity))}").rstrip(
        ", "
    )
    what = f"{get_title(quantity)}: {STATISTIC_TITLES[statistic]}{unit}"
    where = "" if statistic in ("density", "amplitude_ratio") else _PIXEL_SETS[pixels]
    positive = statistic not in ("bias", "density", "amplitude_ratio")
    layout: dict[str, dict[str, Any]] = {
        "title": {"text": f"{what}<br><sub>{where}</sub>" if where else what},
        "xaxis": {"title": {"text": case.varied}, **_axis(case, rows)},
        "yaxis": {
            "title": {"text": f"{STATISTIC_TITLES[statistic]}{unit}"},
            "type": "log" if positive else "linear",
            "exponentformat": "power",
        },
    }
    if positive:
        layout["yaxis"] |= _plain_ticks(data)
    elif statistic == "density":
        for line in data:
            line["y"] = [None if value is None else 100 * value for value in line["y"]]
        layout["yaxis"]["range"] = [-3, 106]
    elif statistic == "amplitude_ratio":
        layout["yaxis"]["range"] = [-0.05, 1.25]
    return Chart(
        f"{case.kind}-{quantity}-{statistic}", f"{what}, over {case.varied}. {_describe_lines(data)}", data, layout
    )


def _plain_ticks(data: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the ticks of a logarithmic axis as plain numbers: 1, 2 and 5 of every decade of the values.

    >>> _plain_ticks([{"y": [0.0015, None, 0.006]}])["ticktext"]
    ['0.001', '0.002', '0.005', '0.01']
    >>> _plain_ticks([{"y": [1.2e-8, 3e-8]}])["ticktext"]
    ['10⁻⁸', '2 × 10⁻⁸', '5 × 10⁻⁸']
    """
    known = [value for line in data for value in line["y"] if value is not None and value > 0]
    if not known:
        return {}
    ticks = [
        step * 10.0**power
        for power in range(math.floor(math.log10(min(known))) - 1, math.ceil(math.log10(max(known))) + 1)
        for step in (1, 2, 5)
    ]
    low, high = (bisect(ticks, bound * (1 + sign * 1e-9)) for bound, sign in ((min(known), 1), (max(known), -1)))
    shown = ticks[max(low - 1, 0) : high + 1]
    # Several decades have space for the first tick of each.
    shown = shown if len(shown) <= _MOST_TICKS else [tick for tick in shown if f"{tick:e}".startswith("1")]
    return {
        "tickvals": shown,
        "ticktext": [format_two_digits(tick).replace("1.0 × ", "").replace(".0 ", " ") for tick in shown],
    }


_MOST_TICKS = 10
_GROWTH = ("growth_rate_windowed",)
"""Quantities of additional records, charted like the quantities of a case."""
_PIXEL_SETS = {COMMON_VALID: "pixels valid for all methods", METHOD_VALID: "valid pixels of each method"}
_CONFIDENCE: Mapping[str, tuple[str, str, str]] = {
    "coverage": (
        "Coverage of the stated uncertainty",
        "number of stated standard deviations",
        "fraction of errors within",
    ),
    "sparsification_rmse": ("Sparsification curve", "fraction of the most certain pixels", "RMSE"),
}


def _confidence(found: BenchmarkResult, case: Case, rows: Sequence[BenchmarkRecord], statistic: str) -> Chart | None:
    quantity = case.headline[0]
    chosen = [row for row in rows if _is(row, quantity, statistic, METHOD_VALID)]
    if not chosen:
        return None
    value = _middle_level(chosen)
    title, x, y = _CONFIDENCE[statistic]
    data = []
    for place, label in enumerate(found.methods):
        points = sorted(
            (row for row in chosen if row.method == label and row.level == value), key=lambda row: row.threshold
        )
        if points:
            line = _line(case, label, place, points)
            line |= {"x": [row.threshold for row in points], "mode": "lines+markers"}
            data.append(line)
    if statistic == "coverage":
        at = [k / 20 for k in range(61)]
        perfect = [math.erf(one / math.sqrt(2)) for one in at]
        style = {"color": "#444444", "dash": "longdash", "width": 1.5}
        data.append({"name": "Gaussian errors", "x": at, "y": perfect, "mode": "lines", "line": style})
    else:
        y = f"{y}, {format_unit(get_units(quantity))}".rstrip(", ")
    layout = {
        "title": {"text": f"{get_title(quantity)}: {title.lower()}<br><sub>{case.describe_level(value)}</sub>"},
        "xaxis": {"title": {"text": x}},
        "yaxis": {"title": {"text": y}, "rangemode": "tozero"},
    }
    return Chart(
        f"{case.kind}-{statistic}",
        f"{title} of {get_title(quantity)}: {y} over {x}. {_describe_lines(data)}",
        data,
        layout,
    )


def describe_stated_uncertainty(found: BenchmarkResult, case: Case) -> Iterator[str]:
    """Yield a sentence for each method whose stated standard deviations are wrong, at the level of the charts."""
    quantity = case.headline[0]
    rows = [row for row in found.rows if row.case == case.kind and row.quantity == quantity]
    name = get_title(quantity).lower()
    for label in found.methods:
        curves = {
            statistic: {row.threshold: row.value for row in chosen if row.method == label and row.level == level}
            for statistic in _CONFIDENCE
            if (chosen := [row for row in rows if _is(row, quantity, statistic, METHOD_VALID)])
            for level in [_middle_level(chosen)]
        }
        within = {at: share for at, share in curves.get("coverage", {}).items() if math.isfinite(share)}
        for at, too_small in ((2.0, True), (1.0, False)):
            share, expected = within.get(at, math.nan), math.erf(at / math.sqrt(2))
            if (share < expected - _COVERAGE_TOLERANCE) if too_small else (share > expected + _COVERAGE_TOLERANCE):
                yield (
                    f"{label}: {100 * share:.0f}\N{NO-BREAK SPACE}% of the errors of {name} are within {at:g} stated "
                    f"standard deviation{'s' if at > 1 else ''} ({100 * expected:.0f}\N{NO-BREAK SPACE}% if correct): "
                    f"its stated standard deviations are too {'small' if too_small else 'large'} here."
                )
        kept = {at: value for at, value in curves.get("sparsification_rmse", {}).items() if math.isfinite(value)}
        if kept and kept[min(kept)] > _SPARSIFICATION_TOLERANCE * kept[max(kept)]:
            yield (
                f"{label}: pixels with the smallest stated standard deviations have larger errors of {name} than all "
                "pixels here: its stated standard deviations do not rank the pixels."
            )


_COVERAGE_TOLERANCE, _SPARSIFICATION_TOLERANCE = 0.1, 1.1


def _middle_level(rows: Sequence[BenchmarkRecord]) -> float:
    """Return the level of the charts of the stated uncertainty."""
    values = sorted({row.level for row in rows})
    return values[len(values) // 2]


def _line(case: Case, label: str, place: int, points: Sequence[BenchmarkRecord]) -> dict[str, Any]:
    numbers = [_finite(abs(row.value) if row.statistic == "rmse" else row.value) for row in points]
    line: dict[str, Any] = {
        "name": label,
        "x": [_place(case, row.level) for row in points],
        "y": numbers,
        # Named levels have no order.
        "mode": "markers" if case.labels() else "lines+markers",
        "line": {"color": COLOURS[place % len(COLOURS)], "dash": _DASHES[place // len(COLOURS) % len(_DASHES)]},
        "marker": {"symbol": _SYMBOLS[place % len(_SYMBOLS)], "size": 8},
    }
    if any(math.isfinite(row.ci_low) for row in points):
        line["error_y"] = {
            "type": "data",
            "symmetric": False,
            "array": [_finite(row.ci_high - row.value) for row in points],
            "arrayminus": [_finite(row.value - row.ci_low) for row in points],
            "thickness": 1,
        }
    return line


def _describe_lines(data: Iterable[Mapping[str, Any]]) -> str:
    """Describe a chart: the first and last point of each line, or the smallest and largest of named levels."""
    entries = []
    for line in data:
        points = [(x, y) for x, y in zip(line["x"], line["y"], strict=True) if y is not None]
        if points:
            if isinstance(points[0][0], str):
                points.sort(key=lambda point: point[1])
            (x0, y0), (x1, y1) = points[0], points[-1]
            entries.append(
                f"{line['name']}: {format_two_digits(y0)} at {_format_place(x0)}, "
                f"{format_two_digits(y1)} at {_format_place(x1)}"
            )
    return "; ".join(entries) + "."


def _format_place(place: float | str) -> str:
    return place if isinstance(place, str) else f"{place:g}"


def _place(case: Case, value: float) -> float | str:
    """Return the axis position of a level: its name, if it has one."""
    return case.get_label(value) if case.labels() else value


def _axis(case: Case, rows: Sequence[BenchmarkRecord]) -> dict[str, Any]:
    if case.labels():
        values = sorted({row.level for row in rows if math.isfinite(row.level)})
        names = [case.get_label(value) for value in values]
        return {"type": "category", "categoryorder": "array", "categoryarray": names}
    axis: dict[str, Any] = {"type": "log" if case.logarithmic else "linear"}
    values = sorted({row.level for row in rows if math.isfinite(row.level)})
    if len(values) <= _MOST_LEVELS:
        axis |= {"tickvals": values, "ticktext": [case.get_label(value) for value in values]}
    return axis


_MOST_LEVELS = 8
"""Number of levels up to which each has a tick."""


def _is(row: BenchmarkRecord, quantity: str, statistic: str, pixels: str) -> bool:
    return (row.quantity, row.statistic, row.pixels) == (quantity, statistic, pixels) and math.isfinite(row.level)


def _value(row: BenchmarkRecord) -> float:
    return row.level


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None

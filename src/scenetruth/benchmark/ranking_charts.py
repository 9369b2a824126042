"""Charts of a benchmark, and the methods that rank first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenetruth.benchmark.benchmark_result import BenchmarkResult, RankedMethod, Ranking
from scenetruth.benchmark.cases.case import BOUND, COMMON_VALID, METHOD_VALID, BenchmarkRecord, Case
from scenetruth.html import COLOURS, Chart
from scenetruth.scoring.quantities import get_title, get_units
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = ["RankDifference", "RankLeaders", "build_charts", "compute_rank_leaders"]


@dataclass(frozen=True)
class RankDifference:
    """A figure by which methods of others are ahead of scenetruth's own.

    ``kind``, ``title``: The case, and which value of it if it is of one.
    ``what``: Which figure, in words.
    ``others``: Methods of others that are ahead, each with its figure, the best first.
    ``own``: The best of scenetruth's own with its figure; empty if none of them told anything.
    """

    kind: str
    title: str
    what: str
    others: Sequence[tuple[str, str]]
    own: Sequence[str]


@dataclass(frozen=True)
class RankLeaders:
    """Who is ahead.

    ``own``, ``others``: Labels of scenetruth's own methods and of those of others.
    ``cases``: How many cases methods of others tell; none if there are none of either.
    ``ahead``: The cases in which others are ahead, by what stands for the case.
    ``figures``: How many figures methods of others tell: of each quantity of a case, and of each value that has a name.
    ``ahead_by_figures``: Those of them by which others are ahead.
    ``best``: For each method, the titles of the cases of which it is the best; a method that is alone leads nothing.
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
        """The figures by which others are ahead as lines of a table: case, figure, others, the best of our own."""
        return [
            [one.title, one.what, ", ".join(map(" ".join, one.others)), " ".join(one.own) or "–"]
            for one in self.ahead_by_figures
        ]


def compute_rank_leaders(found: BenchmarkResult) -> RankLeaders:
    """Return who is ahead; equal figures put nobody ahead."""
    others = [label for label in found.methods if label not in found.own]
    best = {label: list[str]() for label in found.methods}
    headlines, figures = found.headlines(), list(_figures(found))
    for one in headlines:
        first, *further = one.of_methods.items() or [("", math.nan)]
        if further and further[0][1] > first[1]:
            best[first[0]].append(one.case.title)
    told, all_told = ([one for one in some if _can_lead(one, found)] for some in (headlines, figures))
    return RankLeaders(
        found.own,
        others,
        len(told),
        [ahead for one in told if (ahead := _rank_difference(one, found)) is not None],
        len(all_told),
        [ahead for one in all_told if (ahead := _rank_difference(one, found)) is not None],
        [(label, titles) for label, titles in best.items() if titles],
    )


def _figures(found: BenchmarkResult) -> Iterator[RankedMethod]:
    """Give all that can be set side by side, quantity by quantity, and name by name where values have some."""
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
    told = [(label, _words(one, found, numbers[label])) for label in before]
    return RankDifference(one.case.kind, title, what, told, [ours[0], _words(one, found, least)] if ours else [])


def _words(one: RankedMethod, found: BenchmarkResult, number: float) -> str:
    unit = "" if one.unit in ("", "1") else f" {one.unit}"
    if one.statistic.startswith("cutoff_period"):
        values = [row.level for row in found.rows if row.case == one.case.kind and math.isfinite(row.level)]
        # Outside of what was measured there is no figure.
        if number == 0:
            return f"under {min(values, default=math.nan):g}{unit}"
        if number == math.inf:
            return f"over {max(values, default=math.nan):g}{unit}"
    return f"{number:.3g}{unit}"


_DASHES = ("solid", "dash", "dot", "dashdot")
_SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")


def build_charts(found: BenchmarkResult, case: Case) -> list[Chart]:
    """Return the charts of a case: errors of its quantities, how much is told, what confidence is worth."""
    rows = [row for row in found.rows if row.case == case.kind]
    charts = []
    told = dict.fromkeys([case.headline[0], *case.quantities, *_GROWTH])
    waves = {row.quantity for row in rows if row.statistic == "amplitude_ratio"}
    for quantity in told:
        statistic = case.headline[1] if quantity == case.headline[0] else "rmse"
        # Periods at which a tenth is lost follow from this curve.
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
    """Return a figure over what is varied, a line for each method, with its confidence interval."""
    own, common = (
        {(row.method, row.level) for row in rows if _is(row, quantity, statistic, pixels)}
        for pixels in (METHOD_VALID, COMMON_VALID)
    )
    # Where one method tells nothing, there are no pixels that all tell; the others are shown all the same.
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
                "name": "bound of noise",
                "x": [_place(case, row.level) for row in bounds],
                "y": [_finite(row.value) for row in bounds],
                "mode": "lines",
                "line": {"color": "#444444", "dash": "longdash", "width": 1.5},
            }
        )
    unit = "" if statistic in ("density", "amplitude_ratio") else f", {get_units(quantity)}"
    what = f"{get_title(quantity)}: {STATISTIC_TITLES[statistic]}{unit}"
    where = "" if statistic in ("density", "amplitude_ratio") else _PIXEL_SETS[pixels]
    positive = statistic not in ("bias", "density", "amplitude_ratio")
    layout: dict[str, dict[str, Any]] = {
        "title": {"text": f"{what}<br><sub>{where}</sub>" if where else what},
        "xaxis": {"title": {"text": case.varied}, **_axis(case, rows)},
        "yaxis": {"type": "log" if positive else "linear", "exponentformat": "power"},
    }
    if statistic in ("density", "amplitude_ratio"):
        layout["yaxis"]["range"] = [-0.05, 1.25]
    return Chart(
        f"{case.kind}-{quantity}-{statistic}", f"{what}, over {case.varied}. {_describe_lines(data)}", data, layout
    )


_GROWTH = ("growth_rate_windowed",)
"""What further figures of cases tell, and is drawn as their quantities are."""
_PIXEL_SETS = {COMMON_VALID: "pixels that all methods tell", METHOD_VALID: "pixels that each method tells"}
_CONFIDENCE: Mapping[str, tuple[str, str, str]] = {
    "coverage": (
        "Errors within the stated bars",
        "stated standard deviations",
        "share of errors within so many",
    ),
    "sparsification_rmse": ("Errors of the surest pixels", "share of the pixels that is kept", "RMSE"),
}


def _confidence(found: BenchmarkResult, case: Case, rows: Sequence[BenchmarkRecord], statistic: str) -> Chart | None:
    quantity = case.headline[0]
    chosen = [row for row in rows if _is(row, quantity, statistic, METHOD_VALID)]
    if not chosen:
        return None
    values = sorted({row.level for row in chosen})
    value = values[len(values) // 2]
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
        data.append({"name": "honest", "x": at, "y": perfect, "mode": "lines", "line": style})
    else:
        y = f"{y}, {get_units(quantity)}"
    layout = {
        "title": {
            "text": f"{get_title(quantity)}: {title.lower()}<br><sub>at {case.varied} = {case.label_of(value)}</sub>"
        },
        "xaxis": {"title": {"text": x}},
        "yaxis": {"title": {"text": y}, "rangemode": "tozero"},
    }
    return Chart(
        f"{case.kind}-{statistic}",
        f"{title} of {get_title(quantity)}: {y} over {x}. {_describe_lines(data)}",
        data,
        layout,
    )


def _line(case: Case, label: str, place: int, points: Sequence[BenchmarkRecord]) -> dict[str, Any]:
    numbers = [_finite(abs(row.value) if row.statistic == "rmse" else row.value) for row in points]
    line: dict[str, Any] = {
        "name": label,
        "x": [_place(case, row.level) for row in points],
        "y": numbers,
        # Between things that have names there is nothing.
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
    """Say a chart in words: each line from its first point to its last, or from the least to the largest of names."""
    told = []
    for line in data:
        points = [(x, y) for x, y in zip(line["x"], line["y"], strict=True) if y is not None]
        if points:
            if isinstance(points[0][0], str):
                points.sort(key=lambda point: point[1])
            (x0, y0), (x1, y1) = points[0], points[-1]
            told.append(f"{line['name']}: {y0:.2g} at {_format_place(x0)}, {y1:.2g} at {_format_place(x1)}")
    return "; ".join(told) + "."


def _format_place(place: float | str) -> str:
    return place if isinstance(place, str) else f"{place:g}"


def _place(case: Case, value: float) -> float | str:
    """Return where a value is drawn: by its name, if it has one."""
    return case.label_of(value) if case.labels() else value


def _axis(case: Case, rows: Sequence[BenchmarkRecord]) -> dict[str, Any]:
    if case.labels():
        values = sorted({row.level for row in rows if math.isfinite(row.level)})
        names = [case.label_of(value) for value in values]
        return {"type": "category", "categoryorder": "array", "categoryarray": names}
    return {"type": "log" if case.logarithmic else "linear"}


def _is(row: BenchmarkRecord, quantity: str, statistic: str, pixels: str) -> bool:
    return (row.quantity, row.statistic, row.pixels) == (quantity, statistic, pixels) and math.isfinite(row.level)


def _value(row: BenchmarkRecord) -> float:
    return row.level


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None

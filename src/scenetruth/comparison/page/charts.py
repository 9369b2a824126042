"""Charts of a comparison, as plain values that plotly's JavaScript draws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.page.leads import STATISTIC_TITLES
from scenetruth.comparison.result import Comparison
from scenetruth.comparison.rows import BOUND, COMMON, OWN, Row
from scenetruth.pages.charts import COLOURS, Chart
from scenetruth.scoring.quantities import title_of, units_of

__all__ = ["charts_of"]

_DASHES = ("solid", "dash", "dot", "dashdot")
_SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")


def charts_of(found: Comparison, case: Case) -> list[Chart]:
    """Return the charts of a case: errors of its quantities, how much is told, what confidence is worth.

    Parameters
    ----------
    found
        A comparison.
    case
        One of its cases.
    """
    rows = [row for row in found.rows if row.case == case.kind]
    charts = []
    told = dict.fromkeys([case.headline[0], *case.quantities, *_GROWTH])
    waves = {row.quantity for row in rows if row.statistic == "share_left"}
    for quantity in told:
        statistic = case.headline[1] if quantity == case.headline[0] else "rms"
        # Periods at which a tenth is lost follow from this curve.
        chart = _curves(found, case, rows, quantity, "share_left" if quantity in waves else statistic)
        if chart is not None:
            charts.append(chart)
    measured = case.headline[0] if case.headline[0] in case.quantities else case.quantities[0]
    density = _curves(found, case, rows, measured, "density")
    charts += [density] if density is not None else []
    charts += [chart for chart in (_confidence(found, case, rows, name) for name in _CONFIDENCE) if chart is not None]
    return charts


def _curves(found: Comparison, case: Case, rows: Sequence[Row], quantity: str, statistic: str) -> Chart | None:
    """Return a figure over what is varied, a line for each method, with its confidence interval."""
    own, common = (
        {(row.method, row.value) for row in rows if _is(row, quantity, statistic, pixels)} for pixels in (OWN, COMMON)
    )
    # Where one method tells nothing, there are no pixels that all tell; the others are shown all the same.
    pixels = COMMON if common and common == {one for one in own if one[0] != BOUND} else OWN
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
    if bounds and statistic in ("rms", "noise"):
        data.append(
            {
                "name": "bound of noise",
                "x": [_place(case, row.value) for row in bounds],
                "y": [_finite(row.number) for row in bounds],
                "mode": "lines",
                "line": {"color": "#444444", "dash": "longdash", "width": 1.5},
            }
        )
    unit = "" if statistic in ("density", "share_left") else f", {units_of(quantity)}"
    what = f"{title_of(quantity)}: {STATISTIC_TITLES.get(statistic, statistic)}{unit}"
    where = "" if statistic in ("density", "share_left") else _WHERE[pixels]
    positive = statistic not in ("bias", "density", "share_left")
    layout: dict[str, dict[str, Any]] = {
        "title": {"text": f"{what}<br><sub>{where}</sub>" if where else what},
        "xaxis": {"title": {"text": case.varied}, **_axis(case, rows)},
        "yaxis": {"type": "log" if positive else "linear", "exponentformat": "power"},
    }
    if statistic in ("density", "share_left"):
        layout["yaxis"]["range"] = [-0.05, 1.25]
    return Chart(f"{case.kind}-{quantity}-{statistic}", f"{what}, over {case.varied}. {_told(data)}", data, layout)


_GROWTH = ("growth_rate_windowed",)
"""What further figures of cases tell, and is drawn as their quantities are."""
_WHERE = {COMMON: "pixels that all methods tell", OWN: "pixels that each method tells"}
_CONFIDENCE: Mapping[str, tuple[str, str, str]] = {
    "within": (
        "Errors within the stated bars",
        "stated standard deviations",
        "share of errors within so many",
    ),
    "rms_of_surest": ("Errors of the surest pixels", "share of the pixels that is kept", "rms error"),
}


def _confidence(found: Comparison, case: Case, rows: Sequence[Row], statistic: str) -> Chart | None:
    quantity = case.headline[0]
    chosen = [row for row in rows if _is(row, quantity, statistic, OWN)]
    if not chosen:
        return None
    values = sorted({row.value for row in chosen})
    value = values[len(values) // 2]
    title, x, y = _CONFIDENCE[statistic]
    data = []
    for place, label in enumerate(found.methods):
        points = sorted((row for row in chosen if row.method == label and row.value == value), key=lambda row: row.at)
        if points:
            line = _line(case, label, place, points)
            line |= {"x": [row.at for row in points], "mode": "lines+markers"}
            data.append(line)
    if statistic == "within":
        at = [k / 20 for k in range(61)]
        perfect = [math.erf(one / math.sqrt(2)) for one in at]
        style = {"color": "#444444", "dash": "longdash", "width": 1.5}
        data.append({"name": "honest", "x": at, "y": perfect, "mode": "lines", "line": style})
    else:
        y = f"{y}, {units_of(quantity)}"
    layout = {
        "title": {
            "text": f"{title_of(quantity)}: {title.lower()}<br><sub>at {case.varied} = {case.label_of(value)}</sub>"
        },
        "xaxis": {"title": {"text": x}},
        "yaxis": {"title": {"text": y}, "rangemode": "tozero"},
    }
    return Chart(
        f"{case.kind}-{statistic}", f"{title} of {title_of(quantity)}: {y} over {x}. {_told(data)}", data, layout
    )


def _line(case: Case, label: str, place: int, points: Sequence[Row]) -> dict[str, Any]:
    numbers = [_finite(abs(row.number) if row.statistic == "rms" else row.number) for row in points]
    line: dict[str, Any] = {
        "name": label,
        "x": [_place(case, row.value) for row in points],
        "y": numbers,
        # Between things that have names there is nothing.
        "mode": "markers" if case.labels() else "lines+markers",
        "line": {"color": COLOURS[place % len(COLOURS)], "dash": _DASHES[place // len(COLOURS) % len(_DASHES)]},
        "marker": {"symbol": _SYMBOLS[place % len(_SYMBOLS)], "size": 8},
    }
    if any(math.isfinite(row.low) for row in points):
        line["error_y"] = {
            "type": "data",
            "symmetric": False,
            "array": [_finite(row.high - row.number) for row in points],
            "arrayminus": [_finite(row.number - row.low) for row in points],
            "thickness": 1,
        }
    return line


def _told(data: Iterable[Mapping[str, Any]]) -> str:
    """Say a chart in words: each line from its first point to its last, or from the least to the largest of names."""
    told = []
    for line in data:
        points = [(x, y) for x, y in zip(line["x"], line["y"], strict=True) if y is not None]
        if points:
            if isinstance(points[0][0], str):
                points.sort(key=lambda point: point[1])
            (x0, y0), (x1, y1) = points[0], points[-1]
            told.append(f"{line['name']}: {y0:.2g} at {_said(x0)}, {y1:.2g} at {_said(x1)}")
    return "; ".join(told) + "."


def _said(place: float | str) -> str:
    return place if isinstance(place, str) else f"{place:g}"


def _place(case: Case, value: float) -> float | str:
    """Return where a value is drawn: by its name, if it has one."""
    return case.label_of(value) if case.labels() else value


def _axis(case: Case, rows: Sequence[Row]) -> dict[str, Any]:
    if case.labels():
        values = sorted({row.value for row in rows if math.isfinite(row.value)})
        names = [case.label_of(value) for value in values]
        return {"type": "category", "categoryorder": "array", "categoryarray": names}
    return {"type": "log" if case.logarithmic else "linear"}


def _is(row: Row, quantity: str, statistic: str, pixels: str) -> bool:
    return (row.quantity, row.statistic, row.pixels) == (quantity, statistic, pixels) and math.isfinite(row.value)


def _value(row: Row) -> float:
    return row.value


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None

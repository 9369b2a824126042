"""The HTML report of a benchmark, with images of the regions with the largest errors."""

from __future__ import annotations

import inspect
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.benchmark.benchmark_result import BenchmarkResult, RankedMethod
from scenetruth.benchmark.cases.case import ALL, BOUND, COMMON_VALID, METHOD_VALID, SUITES, BenchmarkRecord, Case
from scenetruth.benchmark.design_point import PICTURED_QUANTITIES, CaseErrorMaps
from scenetruth.benchmark.error_statistics import INLIER_PX
from scenetruth.benchmark.ranking_charts import (
    build_charts,
    compute_rank_leaders,
    describe_quantity,
    describe_stated_uncertainty,
)
from scenetruth.estimators import MethodLike, find_method
from scenetruth.estimators.method_specs import read_method
from scenetruth.estimators.user_code import FunctionMethod
from scenetruth.html import render_page
from scenetruth.number_format import format_measured, format_number, format_percent, format_two_digits, format_unit
from scenetruth.output import write_atomically
from scenetruth.scoring.quantities import get_title
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = [
    "WorstRegion",
    "describe_densities",
    "describe_margins",
    "describe_method",
    "describe_ties",
    "select_worst_regions",
    "write_benchmark_report",
]


_MOST = 3
_BEYOND_PERCENT = 2.0
"""Percentage of the errors beyond the colour scale."""


@dataclass(frozen=True)
class WorstRegion:
    """An image of the largest errors of a method: label, title, alternative text, a PNG in base64, and its scale."""

    method: str
    title: str
    alt: str
    picture: str
    limit: str


def select_worst_regions(found: BenchmarkResult, maps: Mapping[tuple[str, float], CaseErrorMaps]) -> list[WorstRegion]:
    """Return images of the levels at which each method has the lowest inlier rate, at most one per case."""
    titles = {case.kind: case for case in found.cases}
    pictures = []
    for label in found.methods:
        shares = sorted(
            (
                (row.value, row.case, row.level, row.quantity)
                for row in found.rows
                if row.method == label
                and row.pixels == ALL
                and row.statistic == "inlier_rate"
                and row.quantity in PICTURED_QUANTITIES
            ),
        )
        seen: set[str] = set()
        for share, kind, value, quantity in shares:
            case = titles[kind]
            one = maps.get((kind, value))
            if kind in seen or len(seen) == _MOST or share > _FINE:
                continue
            if one is None or one.quantity != quantity or label not in one.errors:
                continue
            seen.add(kind)
            none = not np.isfinite(one.errors[label]).any()
            name = get_title(quantity).lower()
            good = f"{name} valid at no evaluated pixel"
            if not none:
                good = f"{name} {_validity(share, _density(found, kind, value, label, quantity))}"
            title = f"{case.title}, {case.describe_level(value)}: {good}"
            words = f"Image of the reference camera and the errors of {one.quantity} by {label}; {title}."
            limit = _scale_px(one.errors[label])
            picture = _drawn(one, label, limit)
            pictures.append(WorstRegion(label, title, words, picture, format_number(limit, 2)))
    return pictures


_FINE = 0.95
"""Inlier rate above which no image is shown."""


def _density(found: BenchmarkResult, kind: str, value: float, label: str, quantity: str) -> float:
    """Return the density of a quantity at a level; NaN if it is not evaluated."""
    wanted = (kind, value, label, quantity, "density")
    rows = (row for row in found.rows if (row.case, row.level, row.method, row.quantity, row.statistic) == wanted)
    return next((row.value for row in rows), math.nan)


def _validity(inliers: float, density: float) -> str:
    r"""Return in words which pixels are valid, and which of them are accurate.

    >>> print(_validity(0.57, 0.57).replace("\N{NO-BREAK SPACE}", " "))
    valid at 57 % of the evaluated pixels, all of them within 0.1 px
    >>> print(_validity(0.45, 0.9).replace("\N{NO-BREAK SPACE}", " "))
    valid at 90 % of the evaluated pixels, 50 % of them within 0.1 px
    """
    limit = f"within {INLIER_PX:g}\N{NO-BREAK SPACE}px"
    if not density > 0:
        return f"{limit} at {format_percent(inliers)} of the evaluated pixels"
    share = min(inliers / density, 1.0)
    accurate = "all" if share > 0.9995 else f"{100 * share:.3g}\N{NO-BREAK SPACE}%"
    return f"valid at {100 * density:.3g}\N{NO-BREAK SPACE}% of the evaluated pixels, {accurate} of them {limit}"


def _scale_px(errors: NDArray[np.float32]) -> float:
    """Return the error at which the colour scale of a picture saturates."""
    sizes = np.abs(errors[np.isfinite(errors)].astype(np.float64))
    return float(np.percentile(sizes, 100 - _BEYOND_PERCENT)) or 1.0 if sizes.size else 1.0


def _drawn(maps: CaseErrorMaps, label: str, limit: float) -> str:
    """Return a PNG of image and errors side by side, with a mark at the largest error; invalid pixels are hatched."""
    from scenetruth.scoring.report.hotspot_pictures import draw_hotspot_map

    image, errors = maps.image.astype(np.float64), maps.errors[label].astype(np.float64)
    return draw_hotspot_map(image, errors, limit)


PAGE = "index.html"


def write_benchmark_report(
    found: BenchmarkResult,
    words: Sequence[Sequence[str]],
    folder: str | Path,
    suite: str,
    maps: Mapping[tuple[str, float], CaseErrorMaps] | None = None,
    descriptions: Mapping[str, str] | None = None,
) -> Path:
    """Write the HTML report of a benchmark; ``descriptions``: those of the methods by label, see `describe_method`."""
    sections = [_section(found, case, words, suite) for case in found.cases]
    charts = {chart.name: {"data": chart.data, "layout": chart.layout} for one in sections for chart in one["charts"]}
    text = render_page(
        "scenetruth.benchmark",
        "comparison.html.j2",
        charts,
        methods=list(zip(found.methods, map(shlex.join, words), strict=True)),
        descriptions=descriptions or {},
        suite=suite,
        sections=sections,
        summary=_summary(found),
        leads=compute_rank_leaders(found),
        efficiency=_efficiency(found),
        efficiency_short=_efficiency_short(found),
        failures=found.failures,
        convention_mismatches=found.convention_mismatches,
        worst=select_worst_regions(found, maps or {}),
        margins=describe_margins(found),
        ties=describe_ties(found),
        densities=describe_densities(found),
        beyond=f"{_BEYOND_PERCENT:g}",
        times=_median_times(found),
    )
    path = Path(folder) / PAGE
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def describe_method(method: MethodLike) -> str:
    """Return the first sentence of the docstring of a method, or of its settings; empty without any.

    >>> describe_method("plane_sweep")
    'Depth by plane sweep: census costs of all cameras with semi-global aggregation.'
    >>> def wall(recording):
    ...     "A wall at 500 mm. It is exact for walls."
    >>> describe_method(wall)
    'A wall at 500 mm.'
    """
    found = find_method(read_method(method).method)
    documented = [found.function] if isinstance(found, FunctionMethod) else [type(found), found.settings]
    text = next((one.__doc__ for one in documented if one.__doc__), "")
    first = " ".join(inspect.cleandoc(text).partition("\n\n")[0].split())
    return re.split(r"(?<=\.) ", first, maxsplit=1)[0]


def describe_margins(found: BenchmarkResult) -> dict[str, list[tuple[str, str]]]:
    """Return for each method the cases in which it is the best of several, and how many times better than the next.

    Cases of `describe_ties` are not among them.
    """
    margins = {label: list[tuple[str, str]]() for label in found.methods}
    for one in found.headlines():
        first, *further = one.of_methods.items() or [("", math.nan)]
        if further and further[0][1] > first[1] and not _overlap(found, one, (first[0], further[0][0])):
            factor = further[0][1] / first[1] if first[1] > 0 and math.isfinite(further[0][1]) else math.inf
            margins[first[0]].append((one.case.title, "" if math.isinf(factor) else format_two_digits(factor)))
    return {label: entries for label, entries in margins.items() if entries}


def describe_ties(found: BenchmarkResult) -> list[str]:
    """Return the cases in which the 95 % confidence intervals of the two best methods overlap at half of the levels."""
    return [one.case.title for one in found.headlines() if _overlap(found, one, list(one.of_methods)[:2])]


def _overlap(found: BenchmarkResult, one: RankedMethod, labels: Sequence[str]) -> bool:
    """Return whether the confidence intervals of two methods overlap at half of the levels or more."""
    chosen: dict[float, dict[tuple[str, str], tuple[float, float]]] = {}
    for row in found.rows:
        if (row.case, row.quantity, row.statistic) == (one.case.kind, one.quantity, one.statistic):
            low, high = sorted((abs(row.ci_low), abs(row.ci_high)))
            crosses = row.ci_low < 0 < row.ci_high
            chosen.setdefault(row.level, {})[row.method, row.pixels] = (0.0 if crosses else low, high)
    overlaps = []
    for of_level in chosen.values():
        for pixels in (COMMON_VALID, METHOD_VALID):
            intervals = [of_level[label, pixels] for label in labels if (label, pixels) in of_level]
            if len(intervals) == 2 and np.isfinite(intervals).all():
                (low, high), (next_low, next_high) = intervals
                overlaps.append(low <= next_high and next_low <= high)
                break
    return 2 * sum(overlaps) >= len(overlaps) > 0


def describe_densities(found: BenchmarkResult) -> str:
    """Return the range of the densities of each method over all cases, for the main quantity of each; or nothing."""
    main = {case.kind: case.headline[0] for case in found.cases}
    ranges = []
    for label in found.methods:
        values = [
            row.value
            for row in found.rows
            if row.method == label and row.statistic == "density" and row.quantity == main.get(row.case)
        ]
        values = [value for value in values if math.isfinite(value)]
        if values:
            low, high = (f"{100 * value:.0f}" for value in (min(values), max(values)))
            ranges.append(f"{label} {low if low == high else f'{low} to {high}'}\N{NO-BREAK SPACE}%")
    return ", ".join(ranges)


def _median_times(found: BenchmarkResult) -> dict[str, str]:
    """Return the median time of an estimate for each method, where it is measured."""
    times = {}
    for label in found.methods:
        values = [
            row.value for row in found.rows if row.method == label and row.statistic == "seconds" and row.value > 0
        ]
        if values:
            times[label] = f"{format_two_digits(float(np.median(values)))}\N{NO-BREAK SPACE}s"
    return times


def _section(found: BenchmarkResult, case: Case, words: Sequence[Sequence[str]], suite: str) -> dict[str, Any]:
    rows = [row for row in found.rows if row.case == case.kind]
    values = sorted({row.level for row in rows if math.isfinite(row.level)})
    table = [
        [
            row.method,
            case.get_label(row.level),
            get_title(row.quantity),
            _PIXELS.get(row.pixels, row.pixels),
            STATISTIC_TITLES[row.statistic],
            format_measured(row.value, 0.5 * (row.ci_high - row.ci_low)),
            format_unit(row.unit),
        ]
        for row in rows
        if row.quantity and row.statistic in _SUMMARY_STATISTICS and row.method != BOUND
    ]
    chosen = ["--suite", suite] if suite != SUITES[0] else []
    named = [word for one in words for word in one]
    again = ["scenetruth", "compare", *named, *chosen, "--case", case.kind, "--level", "VALUE", "-o", "again"]
    concluded = [
        (
            row.method,
            STATISTIC_TITLES.get(row.statistic, row.statistic.replace("_", " ")),
            format_measured(row.value, 0.5 * (row.ci_high - row.ci_low)),
            format_unit(row.unit),
        )
        for row in rows
        if not math.isfinite(row.level) and not _repeats(row, rows)
    ]
    return {
        "case": case,
        "charts": build_charts(found, case),
        "table": table,
        "concluded": concluded,
        "again": shlex.join(again),
        "values": ", ".join(map(case.get_label, values)),
        "stated": [*describe_stated_uncertainty(found, case)],
        "realisations": case.seeds.get(suite, 1),
    }


def _repeats(row: BenchmarkRecord, rows: Sequence[BenchmarkRecord]) -> bool:
    """Return whether a value of the last crossing is that of the first, because there is only one."""
    kind, _, reading = row.statistic.rpartition("_")
    same = (row.method, row.quantity, f"{kind}_first", row.value)
    return reading == "last" and any((one.method, one.quantity, one.statistic, one.value) == same for one in rows)


_PIXELS = {"method_valid": "valid for the method", "common_valid": "valid for all methods"}
_SUMMARY_STATISTICS = (
    "bias",
    "rmse",
    "median_abs_error",
    "noise_std",
    "density",
    "inlier_rate",
    "rms_z",
    "amplitude_ratio",
)


def _summary(found: BenchmarkResult) -> dict[str, Any]:
    frame = found.ranking()
    names = [describe_quantity(one) for one in found.headlines()]
    lines = [
        [name, *(format_number(float(one)) for one in cells)]
        for name, cells in zip(names, frame.to_numpy(), strict=True)
    ]
    return {"columns": [str(one) for one in frame.columns], "lines": lines}


def _efficiency(found: BenchmarkResult) -> list[list[str]]:
    frame = found.efficiency()
    return [
        [str(one) if isinstance(one, str) else format_number(one) for one in cells]
        for cells in frame.itertuples(index=False)
    ]


def _efficiency_short(found: BenchmarkResult) -> dict[str, Any]:
    frame = found.efficiency()
    table = frame.pivot_table(
        index="quantity", columns="method", values="efficiency_percent", aggfunc="median", sort=False
    )
    lines = [[get_title(str(name)), *(format_number(float(one)) for one in cells)] for name, cells in table.iterrows()]
    return {"columns": [str(one) for one in table.columns], "lines": lines}

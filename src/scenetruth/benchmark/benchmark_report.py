"""The HTML report of a benchmark, with images of the regions with the largest errors."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.benchmark.benchmark_result import BenchmarkResult
from scenetruth.benchmark.cases.case import ALL, BOUND, SUITES, Case
from scenetruth.benchmark.design_point import PICTURED_QUANTITIES, CaseErrorMaps
from scenetruth.benchmark.error_statistics import INLIER_PX
from scenetruth.benchmark.ranking_charts import build_charts, compute_rank_leaders, describe_quantity
from scenetruth.html import render_page
from scenetruth.number_format import format_measured, format_number
from scenetruth.output import write_atomically
from scenetruth.scoring.quantities import get_title
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = ["WorstRegion", "write_benchmark_report"]


_MOST = 3
_SCALE_PX = 0.5
"""Error in px at which the colour scale saturates."""


@dataclass(frozen=True)
class WorstRegion:
    """An image of the largest errors of a method: label, title, alternative text, and a PNG in base64."""

    method: str
    title: str
    alt: str
    picture: str


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
            good = f"{name} within {INLIER_PX:g}\u00a0px at {100 * share:.0f}\u00a0% of the pixels"
            good = f"{name} valid at no pixel" if none else good
            title = f"{case.title}, {case.varied} = {case.get_label(value)}: {good}"
            words = f"Image of the reference camera and the errors of {one.quantity} by {label}; {title}."
            pictures.append(WorstRegion(label, title, words, _drawn(one, label)))
    return pictures


_FINE = 0.95
"""Inlier rate above which no image is shown."""


def _drawn(maps: CaseErrorMaps, label: str) -> str:
    """Return a PNG of image and errors side by side, with a mark at the largest error; invalid pixels are hatched."""
    from scenetruth.scoring.report.hotspot_pictures import draw_hotspot_map

    image, errors = maps.image.astype(np.float64), maps.errors[label].astype(np.float64)
    return draw_hotspot_map(image, errors, _SCALE_PX)


def describe_colour_scale() -> Sequence[str]:
    """Return the meanings of the colours."""
    return (
        f"blue is −{_SCALE_PX:g} px and less",
        "white is zero",
        f"red is {_SCALE_PX:g} px and more",
        "hatched is invalid",
        "the square marks the largest error",
    )


PAGE = "index.html"


def write_benchmark_report(
    found: BenchmarkResult,
    words: Sequence[Sequence[str]],
    folder: str | Path,
    suite: str,
    maps: Mapping[tuple[str, float], CaseErrorMaps] | None = None,
) -> Path:
    """Write the HTML report of a benchmark."""
    sections = [_section(found, case, words, suite) for case in found.cases]
    charts = {chart.name: {"data": chart.data, "layout": chart.layout} for one in sections for chart in one["charts"]}
    text = render_page(
        "scenetruth.benchmark",
        "comparison.html.j2",
        charts,
        methods=list(zip(found.methods, map(shlex.join, words), strict=True)),
        suite=suite,
        sections=sections,
        summary=_summary(found),
        leads=compute_rank_leaders(found),
        efficiency=_efficiency(found),
        efficiency_short=_efficiency_short(found),
        failures=found.failures,
        convention_mismatches=found.convention_mismatches,
        worst=select_worst_regions(found, maps or {}),
        scale="; ".join(describe_colour_scale()),
    )
    path = Path(folder) / PAGE
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


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
            "" if row.unit == "1" else row.unit,
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
            row.unit,
        )
        for row in rows
        if not math.isfinite(row.level)
    ]
    return {
        "case": case,
        "charts": build_charts(found, case),
        "table": table,
        "concluded": concluded,
        "again": shlex.join(again),
        "values": ", ".join(map(case.get_label, values)),
    }


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

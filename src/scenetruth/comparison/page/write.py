"""Writes the page: one file of HTML that needs no network."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scenetruth.comparison.case import SUITES, Case
from scenetruth.comparison.maps import Maps
from scenetruth.comparison.page.charts import charts_of
from scenetruth.comparison.page.leads import leads_of
from scenetruth.comparison.page.worst import scale_words, worst_places
from scenetruth.comparison.result import Comparison
from scenetruth.comparison.rows import BOUND
from scenetruth.pages.rendering import page_of
from scenetruth.placing import write_aside

__all__ = ["PAGE", "write_page"]

PAGE = "index.html"


def write_page(
    found: Comparison,
    words: Sequence[Sequence[str]],
    folder: str | Path,
    suite: str,
    maps: Mapping[tuple[str, float], Maps] | None = None,
) -> Path:
    """Write the page of a comparison.

    Parameters
    ----------
    found
        The comparison.
    words
        What the command line calls each of its methods: a word, or an option and its value.
    folder
        Where the page goes.
    suite
        The suite.
    maps
        What is pictured of where methods are at their worst, by case and value.

    Returns
    -------
    pathlib.Path
        The page.
    """
    sections = [_section(found, case, words, suite) for case in found.cases]
    charts = {chart.name: {"data": chart.data, "layout": chart.layout} for one in sections for chart in one["charts"]}
    text = page_of(
        "scenetruth.comparison.page",
        "comparison.html.j2",
        charts,
        methods=list(zip(found.methods, map(shlex.join, words), strict=True)),
        suite=suite,
        sections=sections,
        summary=_summary(found),
        leads=leads_of(found),
        efficiency=_efficiency(found),
        efficiency_short=_efficiency_short(found),
        failures=found.failures,
        slips=found.slips,
        worst=worst_places(found, maps or {}),
        scale="; ".join(scale_words()),
    )
    path = Path(folder) / PAGE
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    return path


def _section(found: Comparison, case: Case, words: Sequence[Sequence[str]], suite: str) -> dict[str, Any]:
    rows = [row for row in found.rows if row.case == case.kind]
    values = sorted({row.value for row in rows if math.isfinite(row.value)})
    table = [
        [row.method, case.label_of(row.value), row.quantity, row.pixels, row.statistic, _number(row.number), row.unit]
        for row in rows
        if row.quantity and row.statistic in _TOLD and row.method != BOUND
    ]
    chosen = ["--suite", suite] if suite != SUITES[0] else []
    named = [word for one in words for word in one]
    again = ["scenetruth", "compare", *named, *chosen, "--case", case.kind, "--value", "VALUE", "-o", "again"]
    concluded = [
        (row.method, row.statistic.replace("_", " "), _number(row.number), row.unit)
        for row in rows
        if not math.isfinite(row.value)
    ]
    return {
        "case": case,
        "charts": charts_of(found, case),
        "table": table,
        "concluded": concluded,
        "again": shlex.join(again),
        "values": ", ".join(map(case.label_of, values)),
    }


_TOLD = ("bias", "rms", "median", "noise", "density", "good", "calibration", "share_left")


def _summary(found: Comparison) -> dict[str, Any]:
    frame = found.summary()
    lines = []
    for name, cells in frame.iterrows():
        numbers = [float(one) for one in cells]
        lines.append([str(name), *(_number(one) for one in numbers)])
    return {"columns": [str(one) for one in frame.columns], "lines": lines}


def _efficiency(found: Comparison) -> list[list[str]]:
    frame = found.efficiency()
    return [
        [str(one) if isinstance(one, str) else _number(one) for one in cells] for cells in frame.itertuples(index=False)
    ]


def _efficiency_short(found: Comparison) -> dict[str, Any]:
    frame = found.efficiency()
    table = frame.pivot_table(
        index="quantity", columns="method", values="efficiency_percent", aggfunc="median", sort=False
    )
    lines = [[str(name), *(_number(float(one)) for one in cells)] for name, cells in table.iterrows()]
    return {"columns": [str(one) for one in table.columns], "lines": lines}


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ("–" if math.isnan(value) else "∞" if value > 0 else "-∞")

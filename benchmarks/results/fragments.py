"""The fragments of the pages: sentences and tables in Markdown, made of the data only."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.results.comparison import (
    ALL_IMAGES,
    GALLERY,
    SAME_IMAGES,
    STATISTICS,
    Value,
    losses,
    relative_values,
    too_small_bars,
    value_of,
    values,
)
from benchmarks.results.contestants import BUILT_IN, CONTESTANTS, OPENCV, SUBMITTED
from benchmarks.results.data import MethodData, markdown, select, spelled
from benchmarks.results.four_images import JOBS
from benchmarks.results.jobs import list_jobs
from scenetruth.benchmark.cases.case import all_cases
from scenetruth.scoring.quantities import get_title

__all__ = ["FRAGMENTS", "Results"]

_NOISE_LEVEL = "0.005"
_PERCENT = "\N{NO-BREAK SPACE}%"
_OF_NOISE = {"waves_of_depth": "disparity", "waves_of_motion": "flow_y"}


class Results:
    """All data of the pages.

    Parameters
    ----------
    methods
        The methods.
    four_images
        Results on four images of full size.
    """

    def __init__(self, methods: Sequence[MethodData], four_images: pd.DataFrame) -> None:
        self.methods = list(methods)
        self.four_images = four_images
        self.values = values(self.methods)
        self.losses = losses(self.methods)
        self.relative = relative_values(self.methods)
        self.bars = too_small_bars(self.methods)
        self.overview = pd.DataFrame([_overview(one) for one in self.methods])

    def method(self, key: str) -> MethodData:
        """Return a method by its key."""
        return next(one for one in self.methods if one.key == key)

    @property
    def best_losses(self) -> pd.DataFrame:
        """The most accurate program of every value in which one is ahead of the built-in method, the largest first."""
        counted = self.losses[self.losses["counts"].astype(bool)]
        # Without a value of the built-in method there is no ratio: the smallest value is the most accurate.
        order = counted.assign(order=counted["ratio"].fillna(0.0)).sort_values(["order", "value"])
        return order.drop_duplicates(["case", "scene", "quantity", "statistic"]).drop(columns="order")


def _overview(one: MethodData) -> dict[str, Any]:
    table = one.table
    suite = table[(table["case"] != GALLERY) & (table["level"] != "")]
    noise = {
        name: _first(select(table, case="noise", level=_NOISE_LEVEL, quantity=name), "noise_std")
        for name in ("disparity", "flow_y", "velocity_z")
    }
    period = {
        case: _first(select(table, case=case, level="", quantity=_HEADLINES[case]), "period_at_10_percent_loss")
        for case in _OF_NOISE
    }
    in_px = suite[suite["bad_percent"].notna()]
    is_headline = [name == _px_quantity(case) for case, name in zip(in_px["case"], in_px["quantity"], strict=True)]
    headline = in_px[np.array(is_headline, dtype=bool)]
    stated = suite[suite["rms_z"].notna()]
    return {
        "method": one.title,
        "images": one.images,
        "disparity_noise_px": noise["disparity"],
        "flow_y_noise_px": noise["flow_y"],
        "velocity_z_noise_mm": noise["velocity_z"],
        "period_of_depth_px": period["waves_of_depth"],
        "period_of_motion_px": period["waves_of_motion"],
        "noise_times_period_of_depth_px2": noise["disparity"] * period["waves_of_depth"],
        "noise_times_period_of_motion_px2": noise["flow_y"] * period["waves_of_motion"],
        "bad_percent": headline["bad_percent"].median(),
        "rms_z": stated["rms_z"].median(),
        "beyond_3_std_percent": stated["beyond_3_std_percent"].median(),
        "processor_s": one.cost.get("processor_s", math.nan),
        "memory_mb": one.cost.get("memory_mb", math.nan),
        "scenes_without_result": len(one.failures),
    }


_HEADLINES = {case: all_cases()[case].headline[0] for case in _OF_NOISE}


def _px_quantity(case: str) -> str:
    quantity = all_cases()[case].headline[0]
    if quantity in ("disparity", "flow_x", "flow_y"):
        return quantity
    return "disparity" if quantity == "depth" else "flow_x"


def _first(frame: pd.DataFrame, column: str) -> float:
    return float(frame[column].iloc[0]) if len(frame) else math.nan


def _number(value: float, column: str) -> str:
    if column == "period_at_10_percent_loss":
        if math.isnan(value):
            return "–"
        if math.isinf(value):
            return "not resolved"
        return "shortest tested" if value == 0 else f"{value:.0f}"
    return spelled(value)


def _what(row: Mapping[str, Any]) -> str:
    unit = f", {row['unit']}" if row["unit"] not in ("", "1") else ""
    return f"{get_title(row['quantity'])}, {STATISTICS[row['statistic']]}{unit}"


def summary(results: Results) -> str:
    """Return the result in words."""
    best = results.best_losses
    compared = [value for value in results.values if _is_compared(results, value)]
    counts = []
    groups = (
        ("benchmark cases by their errors", lambda case, column: case != GALLERY and column != "bad_percent"),
        ("by their bad pixels", lambda case, column: column == "bad_percent"),
        ("errors on complete scenes", lambda case, column: case == GALLERY),
    )
    for name, of_group in groups:
        total = [value for value in compared if of_group(value.case, value.column)]
        lost = [one for one in zip(best["case"], best["statistic"], strict=True) if of_group(*one)]
        if total:
            counts.append(f"{len(lost)} of {len(total)} {name}")
    whole = best[~(best["value"] >= best["refined_all_images_value"])]
    programs = [one for one in results.methods if one.group != BUILT_IN]
    dates = sorted(one.date for one in results.methods if one.date)
    period = dates[0] if dates[0] == dates[-1] else f"from {dates[0]} to {dates[-1]}"
    machines = ", ".join(dict.fromkeys(one.machine for one in results.methods))
    lines = [
        f"With the same four images, at least one other program is more accurate than the built-in method "
        f"[`refined`](../how_to/choose_a_method.md) in {_listed(counts)}. With all images of the recording, "
        f"{len(whole)} of these {len(best)} remain: there, `refined` is less accurate than that program, or has no "
        f"result.",
        f"{len(results.methods)} rows: {len(results.methods) - len(programs)} of built-in methods, {len(programs)} of "
        f"other programs. Measured {'on ' if period == dates[0] else ''}{period} on {machines}; the versions are in "
        f"[a table](#all-methods) below.",
    ]
    missing = sum(len(one.missing) for one in results.methods)
    if missing:
        every = len(list_jobs()) * len(results.methods)
        lines.append(
            f"**The measurement is not complete**: {missing} of {every} jobs (a method on a case, or on a scene of the "
            f"gallery) are [not measured yet](#conditions); `make results` continues.",
        )
    return "\n\n".join(lines)


def _listed(words: Sequence[str]) -> str:
    """Return words with commas, and the last one with "and"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else "none"


def _is_compared(results: Results, value: Value) -> bool:
    others = [one for one in results.methods if one.group != BUILT_IN]
    if value.job in results.method(SAME_IMAGES).missing:
        return False
    return any(not math.isnan(value_of(one, value)[0]) for one in others)


def losses_table(results: Results) -> str:
    """Return the benchmark cases in which a program is ahead."""
    best = results.best_losses
    return _loss_table(best[best["case"] != GALLERY], "benchmark case")


def gallery_losses(results: Results) -> str:
    """Return the complete scenes on which a program is ahead."""
    best = results.best_losses
    if not any(value.case == GALLERY for value in results.values):
        return "Not measured yet."
    return _loss_table(best[best["case"] == GALLERY], "scene")


def _loss_table(frame: pd.DataFrame, first: str) -> str:
    if frame.empty:
        return "None."
    lines = []
    for row in frame.to_dict("records"):
        title = row["scene"] or all_cases()[row["case"]].title
        own, whole = (_number(row[f"refined_{name}value"], row["statistic"]) for name in ("4_", "all_images_"))
        program = f"**{row['program']}** {_number(row['value'], row['statistic'])}"
        density = row["refined_4_valid_percent"]
        lines.append(
            [
                f"{title}: {_what(row)}",
                f"{program} ({spelled(row['valid_percent'])}{_PERCENT} valid)",
                own if math.isnan(density) else f"{own} ({spelled(density)}{_PERCENT} valid)",
                whole,
            ]
        )
    return markdown((first, "most accurate program", "`refined` (4 images)", "`refined` (all images)"), lines)


def cost_losses(results: Results) -> str:
    """Return which programs take less time or memory than the built-in method."""
    own = results.method(SAME_IMAGES).cost
    whole = results.method(ALL_IMAGES).cost
    lines = []
    for name, column, unit in (("time", "processor_s", "s"), ("memory", "memory_mb", "MB")):
        others = sorted(
            (one.cost[column], one.title)
            for one in results.methods
            if one.group != BUILT_IN and one.cost.get(column, math.inf) < own.get(column, math.nan)
        )
        words = ", ".join(f"{title} ({spelled(value)} {unit})" for value, title in others)
        few, many = (_measured_cost(one, column, unit) for one in (own, whole))
        mine = f"`refined` with 4 images: {few}, with all: {many}"
        unmeasured = [one.title for one in results.methods if one.group != BUILT_IN and column not in one.cost]
        without = f" Not measured yet: {', '.join(unmeasured)}." if unmeasured else ""
        less = f" Less: {words or 'none'}." if column in own else ""
        lines.append(f"- **{name.capitalize()}**: {mine}.{less}{without}")
    return "\n".join(lines)


def _measured_cost(cost: Mapping[str, float], column: str, unit: str) -> str:
    return f"{spelled(cost[column])} {unit}" if column in cost else "not measured yet"


def bars_table(results: Results) -> str:
    """Return the built-in methods whose error bars are too small, and where."""
    frame = results.bars
    if frame.empty:
        return "None."
    lines = []
    for method, here in frame.groupby("method", sort=False):
        total = select(results.overview, method=method)
        worst = here.sort_values("beyond_3_std_percent", ascending=False)
        places = ", ".join(
            f"{row['level'] if row['case'] == GALLERY else all_cases()[row['case']].title.lower()} "
            f"({spelled(row['beyond_3_std_percent'])}{_PERCENT})"
            for row in worst.assign(place=worst["level"].where(worst["case"] == GALLERY, worst["case"]))
            .drop_duplicates("place")
            .head(6)
            .to_dict("records")
        )
        lines.append([str(method), spelled(float(total["rms_z"].iloc[0])), str(len(here)), places])
    columns = ("method", "RMS of z, median over the suite", "levels with more than 1 % beyond 3σ", "largest fractions")
    return markdown(columns, lines)


def methods_table(results: Results) -> str:
    """Return noise and resolution, one line for each method."""
    lines = []
    for one, row in _rows(results):
        lines.append(
            [
                f"[{one.title}]({one.link})" if one.link else one.title,
                one.images,
                *(spelled(row[column]) for column in ("disparity_noise_px", "flow_y_noise_px", "velocity_z_noise_mm")),
                *(
                    _number(row[column], "period_at_10_percent_loss")
                    for column in ("period_of_depth_px", "period_of_motion_px")
                ),
            ]
        )
    noise = ("noise of disparity, px", "noise of flow, px", "noise of U_Z, mm")
    periods = ("period of depth at 10 % loss, px", "period of motion at 10 % loss, px")
    return markdown(("method", "images", *noise, *periods), lines)


def robustness_table(results: Results) -> str:
    """Return bad pixels, error bars, time and memory, one line for each method."""
    numbers = ("bad_percent", "rms_z", "beyond_3_std_percent", "processor_s", "memory_mb")
    lines = [
        [f"{one.title}<br>{one.version}", *(spelled(row[name]) for name in numbers), str(row["scenes_without_result"])]
        for one, row in _rows(results)
    ]
    columns = ("bad pixels, %", "z, RMS", "beyond 3σ, %", "time, s", "memory, MB", "scenes without result")
    return markdown(("method", *columns), lines)


def _rows(results: Results) -> list[tuple[MethodData, dict[str, Any]]]:
    return list(zip(results.methods, results.overview.to_dict("records"), strict=True))


def made(results: Results) -> str:
    """Return when, where and with what all was measured."""
    machines = ", ".join(dict.fromkeys(one.machine for one in results.methods))
    minutes = sum(one.processor_s for one in results.methods) / 60
    failures = [
        f"- {one.title}: {'; '.join(f'`{scenes}`: {why}' for scenes, why in _grouped(one.failures).items())}"
        for one in results.methods
        if one.failures
    ]
    lines = [
        f"Processor: {machines}; one thread for each program. The suite and the gallery took {minutes:.0f} min of "
        f"processor time. Scenes on which a method gave no result, in at least one noise realisation, with the reason:",
        "\n".join(failures) or "none.",
    ]
    return "\n\n".join(lines)


def not_measured(results: Results) -> str:
    """Return the jobs that are not measured yet, by name, and those of which methods."""
    found: dict[tuple[str, ...], list[str]] = {}
    for job in dict.fromkeys(name for one in results.methods for name in one.missing):
        found.setdefault(tuple(one.title for one in results.methods if job in one.missing), []).append(job)
    if not found:
        return "All jobs are measured."
    lines = [
        [
            ", ".join(f"`{job}`" for job in jobs),
            f"all {len(titles)}" if len(titles) == len(results.methods) else "; ".join(titles),
            str(len(jobs) * len(titles)),
        ]
        for titles, jobs in sorted(found.items(), key=lambda each: -len(each[0]))
    ]
    total = sum(len(one.missing) for one in results.methods)
    columns = ("not measured yet", "methods", f"jobs ({total} in all)")
    return markdown(columns, lines)


def _grouped(failures: Mapping[str, str]) -> dict[str, str]:
    """Return scenes by reason, several with commas between."""
    found: dict[str, list[str]] = {}
    for scene, why in failures.items():
        found.setdefault(_short(why), []).append(scene)
    return {"`, `".join(scenes): why for why, scenes in found.items()}


def _short(why: str) -> str:
    """Return a reason in one line: the problems of an estimate by its maps, or the last message of a program."""
    problems: dict[str, list[str]] = {}
    for name, problem in _PROBLEM.findall(why):
        problems.setdefault(_REASONS.get(problem, problem), []).append(name)
    lines = why.strip().splitlines()
    said = f"the program ended with the message “{_start_of(lines[0])}”" if lines else "no reason given"
    words = "; ".join(f"{', '.join(names)}: {problem}" for problem, names in problems.items()) or said
    return _start_of(words.replace("|", "/").replace("<", "").replace(">", ""), 160)


def _start_of(message: str, length: int = 90) -> str:
    """Return the first words of a message."""
    return textwrap.shorten(message, length, placeholder=" …")


_PROBLEM = re.compile(r"^\s+- (\w+?)_t[^:]*: ([^;\n]*)", re.MULTILINE)
_REASONS = {"contains only NaN: no valid pixel": "no valid pixel"}


def cases_table(results: Results) -> str:
    """Return the main value of every case for every method."""
    return _table_of_values(results, [value for value in results.values if value.case != GALLERY], "case")


def gallery_table(results: Results) -> str:
    """Return the values of the scenes of the gallery for every method."""
    return _table_of_values(results, [value for value in results.values if value.case == GALLERY], "scene")


def _table_of_values(results: Results, wanted: Sequence[Value], first: str) -> str:
    """Return two tables: methods with all images and OpenCV, and methods with the images of the programs."""
    few = [one for one in results.methods if (one.images != "all" and one.group != OPENCV) or one.group == SUBMITTED]
    tables = []
    for methods in ([one for one in results.methods if one not in few], few):
        lines = []
        for value in wanted:
            row = {"unit": value.unit, "quantity": value.quantity, "statistic": value.column}
            numbers = [value_of(one, value)[0] for one in methods]
            best = min((number for number in numbers if not math.isnan(number)), default=math.nan)
            cells = [_number(number, value.column) for number in numbers]
            cells = [f"**{cell}**" if number == best else cell for cell, number in zip(cells, numbers, strict=True)]
            lines.append([f"{value.title}: {_what(row)}", *cells])
        tables.append(markdown((first, *(one.title for one in methods)), lines))
    return "\n\n".join(tables)


def settings_table(results: Results) -> str:
    """Return algorithm, version, settings and images of every method."""
    known = {one.key: one.description for one in CONTESTANTS}
    lines = [[one.title, known.get(one.key, "–"), one.version, one.how, one.images] for one in results.methods]
    return markdown(("method", "algorithm", "version", "settings", "images"), lines)


_NAMES = {
    "pyvale": "pyvale",
    "pyvale_stereo": "pyvale stereo",
    "al_dic_3d": "al-dic-3d",
    "sun_dic": "SUN-DIC",
    "pyxel": "pyxel",
    "mudic": "muDIC",
    "opencv": "OpenCV",
}
_FOUR_QUANTITIES = {
    "flow": "flow, px",
    "disparity": "disparity, px",
    "depth": "depth, mm",
    "velocity_z": "U_Z, mm per frame",
    "growth_rate": "growth rate, % per hour",
}


def four_images_cube(results: Results) -> str:
    """Return the errors on the cube."""
    return _four(results, ("cube",))


def four_images_leaf(results: Results) -> str:
    """Return the errors on the leaf."""
    return _four(results, ("leaf", "leaf_anisotropic"))


def _four(results: Results, scenes: Sequence[str]) -> str:
    frame = results.four_images
    frame = frame[frame["scene"].isin(scenes)]
    columns = [name for name in _FOUR_QUANTITIES if (frame["quantity"] == name).any()]
    smallest = {name: frame[frame["quantity"] == name]["rmse"].min() for name in columns}
    lines = []
    for job, here in frame.groupby("job", sort=False):
        cells = []
        for name in columns:
            there = select(here, quantity=name)
            if there.empty:
                cells.append("")
                continue
            rmse, median = float(there["rmse"].iloc[0]), float(there["median_abs_error"].iloc[0])
            pair = f"{spelled(rmse)} / {spelled(median)}"
            cells.append(f"**{pair}**" if rmse == smallest[name] else pair)
        lines.append([_title(str(job), here), *cells])
    table = markdown(("program, options", *(_FOUR_QUANTITIES[name] for name in columns)), lines)
    return _with_missing(table, frame, scenes)


def _with_missing(table: str, frame: pd.DataFrame, scenes: Sequence[str]) -> str:
    """Return a table, without its heading if it is empty, and the names of the runs that are not measured yet."""
    there = set(frame["job"])
    missing = [name.partition(":")[0] for name, job in JOBS.items() if job.scene in scenes and name not in there]
    words = f"Not measured yet ({len(missing)} runs): {', '.join(missing)}." if missing else ""
    return "\n\n".join(filter(None, (table if there else "", words)))


def _title(job: str, frame: pd.DataFrame) -> str:
    peer, options, scene = (str(frame[name].iloc[0]) for name in ("method", "options", "scene"))
    name = _NAMES.get(peer) or f"built-in: `{peer}`"
    words = f", `{options}`" if options and options != "nan" else ""
    return f"{name}{words}{', anisotropic growth' if scene == 'leaf_anisotropic' else ''}"


def four_images_star(results: Results) -> str:
    """Return resolution and noise on the star."""
    frame = select(results.four_images, scene="star")
    lines = [
        [
            _title(str(row["job"]), pd.DataFrame([row])),
            f"{row['cutoff_period_first']:.0f}",
            spelled(row["noise_std"]),
            spelled(row["noise_std"] * row["cutoff_period_first"]),
        ]
        for row in frame.to_dict("records")
    ]
    columns = ("program, options", "period at 10 % loss, px", "noise of a static pair, px", "product, px²")
    return _with_missing(markdown(columns, lines), frame, ("star",))


def data_links(results: Results) -> str:
    """Return links to the data of each method."""
    lines = [
        f"- {one.title}: [values](data/methods/{one.key}.csv), [conditions](data/methods/{one.key}.json)"
        for one in results.methods
    ]
    return "\n".join(lines)


FRAGMENTS: Mapping[str, Callable[[Results], str]] = {
    "summary": summary,
    "losses": losses_table,
    "gallery-losses": gallery_losses,
    "cost": cost_losses,
    "error-bars": bars_table,
    "methods": methods_table,
    "robustness": robustness_table,
    "made": made,
    "not-measured": not_measured,
    "cases": cases_table,
    "gallery": gallery_table,
    "settings": settings_table,
    "cube": four_images_cube,
    "leaf": four_images_leaf,
    "star": four_images_star,
    "data": data_links,
}
"""The text of each fragment, by its name in the pages."""

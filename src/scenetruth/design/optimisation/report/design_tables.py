"""Tables of a design: recommended rig, alternatives, constraints, sensitivities, rules of thumb."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, TypeGuard

from scenetruth.design.optimisation.catalogues import load_catalogues
from scenetruth.design.optimisation.design_records import (
    ConstraintValue,
    DesignSpecError,
    PredictionInterval,
    RigDesign,
    compute_rig_interval,
)
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.report.scene_file import build_scene_file
from scenetruth.design.parameter_words import parameter_unit, title_parameter
from scenetruth.html import HtmlCell, HtmlTable
from scenetruth.number_format import (
    UNDEFINED,
    format_estimate,
    format_interval,
    format_length,
    format_measured,
    format_number,
    format_percent,
    format_signed_percent,
    format_value,
)
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = [
    "build_constraint_table",
    "build_discrepancy_table",
    "build_front_table",
    "build_parameter_table",
    "build_rank_consistency_table",
    "build_rule_table",
    "build_sensitivity_table",
    "find_tightest",
    "get_catalogue_titles",
]

_NOTHING = PredictionInterval(math.nan, math.nan, math.nan, 0)
_OTHER: Mapping[str, Mapping[str, str]] = {
    "scaled_median_abs_error": {"rmse": STATISTIC_TITLES["rmse"]},
    "rmse": {"scaled_median_abs_error": STATISTIC_TITLES["scaled_median_abs_error"]},
    "p95_abs_error": {"rmse": STATISTIC_TITLES["rmse"]},
}
"""Additional simulated statistics in the table of rigs, by statistic of the objective."""
_AT_THE_END = 0.01  # distance from an end that counts as the end of the range, as a fraction of the range


def get_catalogue_titles(design: DesignResult) -> dict[str, str]:
    """Return the titles of the catalogue entries of the recommended rig, by design variable."""
    with suppress(DesignSpecError):
        entries = load_catalogues(design.specification.get("catalogues") or ())
        kinds: dict[str, Mapping[str, Any]] = {
            "lens": entries.lenses,
            "camera": entries.cameras,
            "stage": entries.stages,
        }
        chosen = {
            name: kinds[name].get(value) for name, value in design.recommended.parameters.items() if name in kinds
        }
        return {name: entry.title for name, entry in chosen.items() if entry is not None}
    return {}


def build_parameter_table(design: DesignResult) -> HtmlTable:
    """Return the table of design variables of the recommended rig with their ranges."""
    variables, titles = design.specification.get("variables", {}), get_catalogue_titles(design)
    lines = []
    for path, value in design.recommended.parameters.items():
        entry = variables.get(path) if isinstance(variables, Mapping) else None
        chosen, at_end = _range(entry, value)
        unit = parameter_unit(path)
        number = f"{format_value(value)} {unit}" if unit and _is_number(value) else format_value(value)
        text = f"{titles[path]} ({value})" if path in titles else number
        title = "lens" if path == "lens" else title_parameter(path)
        lines.append(
            [HtmlCell(title), HtmlCell(path), HtmlCell(text, _sort_key(value)), HtmlCell(chosen), HtmlCell(at_end)]
        )
    caption = "Design variables with their ranges or choices"
    return HtmlTable(
        "parameters", caption, ["parameter", "field", "value", "range or choices", "end of the range"], lines
    )


def build_front_table(design: DesignResult) -> HtmlTable:
    """Return the table of the front and the alternatives, one row per rig."""
    parameters = list(design.recommended.parameters)
    columns = ["rig", "on the front"]
    statistics = ", ".join(dict.fromkeys(objective.statistic_title for objective in design.objectives))
    rigs, first = design.rigs, {rig.number for rig in design.front}
    for objective in design.objectives:
        columns += [
            f"{objective.title}: predicted, {objective.unit}",
            "simulated",
            "95 %",
            *_OTHER[objective.statistic].values(),
        ]
    priced = any(rig.price is not None for rig in rigs)
    columns += [*("lens" if path == "lens" else title_parameter(path) for path in parameters)]
    columns += [*(["price, €"] if priced else []), "tightest constraint", "limiting factors", "scene file"]
    lines, marked = [], None
    for place, rig in enumerate(rigs):
        is_best = rig.number == design.recommended.number
        marked = place if is_best else marked
        line = [HtmlCell(f"{rig.number} (recommended)" if is_best else str(rig.number), rig.number)]
        line.append(HtmlCell("yes" if rig.number in first else "no"))
        for objective in design.objectives:
            found = rig.simulated.get(objective.title, _NOTHING)
            entries = format_interval(found.pi_low, found.pi_high) or UNDEFINED
            line += [_number_cell(rig.predicted.get(objective.title)), _measured_cell(found)]
            line.append(HtmlCell(entries, found.pi_low if math.isfinite(found.pi_low) else None))
            others = [compute_rig_interval(rig, objective.title, name) for name in _OTHER[objective.statistic]]
            line += [_measured_cell(one) for one in others]
        line += [
            HtmlCell(format_value(value), _sort_key(value))
            for value in (rig.parameters.get(path, "") for path in parameters)
        ]
        line += [_number_cell(rig.price)] if priced else []
        # The constraints have a table of their own.
        line += [_tightest_cell(rig), HtmlCell(rig.limits.partition("; active constraints:")[0] or UNDEFINED)]
        file = build_scene_file(rig, f"rig_{rig.number}.yaml")
        lines.append([*line, HtmlCell(file.name, float(rig.number), file.address, file.name)])
    return HtmlTable(
        "front",
        f"Pareto front (non-dominated rigs by prediction) and alternatives; {statistics}",
        columns,
        lines,
        marked,
    )


def _with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; ratios have none."""
    return text if unit in ("", "1") else f"{text} {unit}"


def build_constraint_table(rig: RigDesign) -> HtmlTable:
    """Return the table of constraints of a rig, the tightest first."""
    lines = [
        [
            HtmlCell(one.title),
            HtmlCell(_with_unit(format_length(one.value), one.unit), _finite(one.value)),
            HtmlCell(_with_unit(f"{one.sense} {format_length(one.limit)}", one.unit), one.limit),
            HtmlCell(format_percent(one.margin), one.margin if math.isfinite(one.margin) else None),
            HtmlCell("yes" if one.holds else "no"),
        ]
        for one in sorted(rig.constraints, key=_tightness)
    ]
    columns = ["constraint", "value", "bound", "relative margin", "satisfied"]
    return HtmlTable("constraints", f"Constraints of rig {rig.number}, the tightest first", columns, lines)


def find_tightest(rig: RigDesign) -> ConstraintValue | None:
    """Return the constraint with the smallest margin; None without constraints."""
    return min(rig.constraints, key=_tightness, default=None)


def build_sensitivity_table(design: DesignResult) -> HtmlTable:
    """Return the table of sensitivities."""
    lines = [
        [
            HtmlCell(title_parameter(one.parameter)),
            HtmlCell(one.objective),
            *(HtmlCell(format_signed_percent(each), _finite(each)) for each in (one.ten_percent, one.ten_percent_less)),
            *(
                HtmlCell(format_estimate(index, half, one.sobol_samples), _finite(index))
                for index, half in ((one.sobol_first, one.sobol_first_half), (one.sobol_total, one.sobol_total_half))
            ),
            *map(_number_cell, (one.morris_mu_star, one.morris_sigma)),
        ]
        for one in design.sensitivities
    ]
    columns = ["parameter", "objective", "10 % increase", "10 % decrease", "Sobol' first-order", "Sobol' total"]
    columns += ["Morris μ*", "Morris σ"]
    return HtmlTable("sensitivities", "Sensitivities of the objectives to the parameters", columns, lines)


def build_rule_table(design: DesignResult) -> HtmlTable:
    """Return the table of rules of thumb for the recommended rig."""
    lines = [
        [
            HtmlCell(one.title),
            HtmlCell(one.says),
            HtmlCell(one.here),
            HtmlCell("yes" if one.holds else "no"),
            HtmlCell(one.source),
        ]
        for one in design.rules
    ]
    columns = ["rule", "criterion", "recommended rig", "satisfied", "source"]
    return HtmlTable("rules", "Rules of thumb for the recommended rig", columns, lines)


def build_discrepancy_table(design: DesignResult) -> HtmlTable:
    """Return the table of predictions and simulations."""
    lines = [
        [
            HtmlCell(str(one.rig), one.rig),
            HtmlCell(one.objective),
            _number_cell(one.predicted),
            _measured_cell(one.simulated),
            HtmlCell(
                format_interval(one.simulated.pi_low, one.simulated.pi_high) or UNDEFINED, _finite(one.simulated.pi_low)
            ),
            HtmlCell(str(one.simulated.seeds), one.simulated.seeds),
            _number_cell(one.ratio),
            HtmlCell("differs" if one.notable else "agrees"),
            HtmlCell(one.says),
        ]
        for one in design.discrepancies
    ]
    columns = [
        "rig",
        "objective",
        "predicted",
        "simulated",
        "95 %",
        "recordings",
        "ratio",
        "verdict",
        "description",
    ]
    return HtmlTable("discrepancies", "Prediction and simulation of every simulated rig", columns, lines)


def build_rank_consistency_table(design: DesignResult) -> HtmlTable:
    """Return the table of rank consistency, one row per pair of rigs."""
    lines = [
        [
            HtmlCell(one.objective),
            HtmlCell(str(one.better), one.better),
            HtmlCell(str(one.worse), one.worse),
            _number_cell(one.predicted),
            _number_cell(one.simulated),
            HtmlCell(format_interval(one.ci_low, one.ci_high) or UNDEFINED, _finite(one.ci_low)),
            HtmlCell(str(one.seeds), one.seeds),
            HtmlCell(one.verdict),
        ]
        for one in design.orders
    ]
    columns = ["objective", "better rig", "worse rig", "predicted ratio", "simulated ratio", "95 %", "seeds"]
    caption = "Rank of pairs of rigs: predicted and simulated ratio, worse over better, paired by seed"
    return HtmlTable("orders", caption, [*columns, "order"], lines)


def _tightest_cell(rig: RigDesign) -> HtmlCell:
    one = find_tightest(rig)
    if one is None:
        return HtmlCell(UNDEFINED)
    return HtmlCell(
        f"{one.title}, {format_percent(one.margin)} left" if one.holds else f"{one.title}: violated", one.margin
    )


def _tightness(one: ConstraintValue) -> tuple[bool, float]:
    return one.holds, math.inf if math.isnan(one.margin) else one.margin


def _range(entry: Any, value: Any) -> tuple[str, str]:
    """Return the range or choices of a parameter, and the end at which the value is."""
    entries = entry if isinstance(entry, Mapping) else {"values": entry}
    low, high, values = entries.get("from"), entries.get("to"), entries.get("values")
    if _is_number(low) and _is_number(high):
        between = f"{format_value(low)} to {format_value(high)}"
        if not entries.get("log"):
            spare = _AT_THE_END * (high - low)
            return between, _end(value, low + spare, high - spare)
        factor = (high / low) ** _AT_THE_END
        return f"{between}, logarithmic", _end(value, factor * low, high / factor)
    if isinstance(values, list | tuple):
        ordered = len(values) > 1 and all(map(_is_number, values))
        return format_value(values), _end(value, min(values), max(values)) if ordered else UNDEFINED
    return (UNDEFINED if values is None else format_value(values)), UNDEFINED


def _end(value: Any, low: float, high: float) -> str:
    if not _is_number(value):
        return UNDEFINED
    return "lower end" if value <= low else "upper end" if value >= high else "no"


def _is_number(value: Any) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _sort_key(value: Any) -> float | None:
    return float(value) if _is_number(value) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _measured_cell(found: PredictionInterval) -> HtmlCell:
    """Return the cell of a simulated value, with the digits that its interval justifies."""
    text = format_measured(found.value, 0.5 * (found.pi_high - found.pi_low))
    return HtmlCell(text, _finite(found.value))


def _number_cell(value: float | None, unit: str = "") -> HtmlCell:
    if value is None or not math.isfinite(value):
        return HtmlCell(format_number(value))
    return HtmlCell(f"{format_number(value)} {unit}".rstrip(), float(value))

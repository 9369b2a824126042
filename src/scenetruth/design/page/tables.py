"""What a design says in tables: the recommended rig, the alternatives, constraints, sensitivities, rules."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeGuard

from scenetruth.design.optimise.confirm.intervals import interval_at
from scenetruth.design.optimise.result import Constraint, Design, Interval, Rig
from scenetruth.design.page.scene_file import scene_file_of
from scenetruth.design.page.words import UNDEFINED, estimate, interval, length, number, percent, said, signed_percent
from scenetruth.pages.tables import Cell, Table

__all__ = [
    "constraint_table",
    "discrepancy_table",
    "front_table",
    "order_table",
    "parameter_table",
    "rule_table",
    "sensitivity_table",
    "tightest_of",
]

_NOTHING = Interval(math.nan, math.nan, math.nan, 0)
_OTHER: Mapping[str, Mapping[str, str]] = {
    "typical": {"rms": "rms error"},
    "rms": {"typical": "typical error"},
    "percentile_95": {"rms": "rms error"},
}
"""What is told of simulations besides an objective's statistic."""
_AT_THE_END = 0.01
"""A parameter is at the end of its range if no more than this share of the range is left."""


def parameter_table(design: Design) -> Table:
    """Return what was free at the recommended rig, with the range it was chosen from."""
    free = design.goal.get("free", {})
    lines = []
    for path, value in design.recommended.parameters.items():
        entry = free.get(path) if isinstance(free, Mapping) else None
        chosen, at_end = _range(entry, value)
        lines.append([Cell(path), Cell(said(value), _key(value)), Cell(chosen), Cell(at_end)])
    caption = "What was free, what it was chosen from, and whether that range ends here"
    return Table("parameters", caption, ["parameter", "value", "chosen from", "end of the range"], lines)


def front_table(design: Design) -> Table:
    """Return the front and the alternatives, a rig each line."""
    parameters = list(design.recommended.parameters)
    columns = ["rig", "on the front"]
    rigs, first = design.rigs, {rig.number for rig in design.front}
    for objective in design.objectives:
        of = f"{objective.title}, {objective.unit}"
        columns += [f"{of}: predicted {objective.told_in}", "simulated", "95 %", *_OTHER[objective.statistic].values()]
    priced = any(rig.price is not None for rig in rigs)
    columns += [*parameters, *(["price, €"] if priced else []), "tightest constraint", "what limits", "scene file"]
    lines, marked = [], None
    for place, rig in enumerate(rigs):
        is_best = rig.number == design.recommended.number
        marked = place if is_best else marked
        line = [Cell(f"{rig.number} (recommended)" if is_best else str(rig.number), rig.number)]
        line.append(Cell("yes" if rig.number in first else "no"))
        for objective in design.objectives:
            found = rig.simulated.get(objective.title, _NOTHING)
            told = interval(found.low, found.high) or UNDEFINED
            line += [_number_cell(rig.predicted.get(objective.title)), _number_cell(found.number)]
            line.append(Cell(told, found.low if math.isfinite(found.low) else None))
            others = [interval_at(rig, objective.title, name) for name in _OTHER[objective.statistic]]
            line += [_number_cell(one.number) for one in others]
        line += [Cell(said(value), _key(value)) for value in (rig.parameters.get(path, "") for path in parameters)]
        line += [_number_cell(rig.price)] if priced else []
        line += [_tightest_cell(rig), Cell(rig.limits or UNDEFINED)]
        file = scene_file_of(rig, f"rig_{rig.number}.yaml")
        lines.append([*line, Cell(file.name, float(rig.number), file.address, file.name)])
    return Table(
        "front",
        "The front: rigs than which no other is predicted to be better in every objective; and alternatives behind it",
        columns,
        lines,
        marked,
    )


def constraint_table(rig: Rig) -> Table:
    """Return the constraints of a rig, the tightest first."""
    lines = [
        [
            Cell(one.title),
            Cell(f"{length(one.value)} {one.unit}".rstrip(), _finite(one.value)),
            Cell(f"{one.sense} {length(one.limit)} {one.unit}".rstrip(), one.limit),
            Cell(percent(one.margin), one.margin if math.isfinite(one.margin) else None),
            Cell("holds" if one.holds else "does not hold"),
        ]
        for one in sorted(rig.constraints, key=_tightness)
    ]
    columns = ["constraint", "here", "allowed", "margin, share of the limit", "does it hold"]
    return Table("constraints", f"Constraints at rig {rig.number}, the tightest first", columns, lines)


def tightest_of(rig: Rig) -> Constraint | None:
    """Return the constraint of which least is left; None if there are none."""
    return min(rig.constraints, key=_tightness, default=None)


def sensitivity_table(design: Design) -> Table:
    """Return what parameters do to objectives."""
    lines = [
        [
            Cell(one.parameter),
            Cell(one.objective),
            *(Cell(signed_percent(each), _finite(each)) for each in (one.ten_percent, one.ten_percent_less)),
            *(
                Cell(estimate(index, half, one.sobol_samples), _finite(index))
                for index, half in ((one.sobol_first, one.sobol_first_half), (one.sobol_total, one.sobol_total_half))
            ),
            *map(_number_cell, (one.morris_mu_star, one.morris_sigma)),
        ]
        for one in design.sensitivities
    ]
    columns = ["parameter", "objective", "10 % more of it", "10 % less", "Sobol' first", "Sobol' total"]
    columns += ["Morris μ*", "Morris σ"]
    return Table("sensitivities", "What parameters do to objectives", columns, lines)


def rule_table(design: Design) -> Table:
    """Return the rules of thumb, and whether the recommended rig keeps them."""
    lines = [
        [Cell(one.title), Cell(one.says), Cell(one.here), Cell("kept" if one.holds else "not kept"), Cell(one.source)]
        for one in design.rules
    ]
    columns = ["rule", "it says", "here", "is it kept", "source"]
    return Table("rules", "Rules of thumb of the field, at the recommended rig", columns, lines)


def discrepancy_table(design: Design) -> Table:
    """Return predictions beside simulations."""
    lines = [
        [
            Cell(str(one.rig), one.rig),
            Cell(one.objective),
            _number_cell(one.predicted),
            _number_cell(one.simulated.number),
            Cell(interval(one.simulated.low, one.simulated.high) or UNDEFINED, _finite(one.simulated.low)),
            Cell(str(one.simulated.seeds), one.simulated.seeds),
            _number_cell(one.ratio),
            Cell("differs" if one.notable else "agrees"),
            Cell(one.says),
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
        "in words",
    ]
    return Table("discrepancies", "Prediction beside simulation, every rig that was simulated", columns, lines)


def order_table(design: Design) -> Table:
    """Return whether simulations keep the order of predictions, a pair of rigs each line."""
    lines = [
        [
            Cell(one.objective),
            Cell(str(one.better), one.better),
            Cell(str(one.worse), one.worse),
            _number_cell(one.predicted),
            _number_cell(one.simulated),
            Cell(interval(one.low, one.high) or UNDEFINED, _finite(one.low)),
            Cell(str(one.seeds), one.seeds),
            Cell(one.verdict),
        ]
        for one in design.orders
    ]
    columns = ["objective", "better by prediction", "worse", "by a factor of", "simulated factor", "95 %", "seeds"]
    caption = "Order of rigs: by what factor the worse one is worse, from paired figures of the same seeds"
    return Table("orders", caption, [*columns, "order"], lines)


def _tightest_cell(rig: Rig) -> Cell:
    one = tightest_of(rig)
    if one is None:
        return Cell(UNDEFINED)
    return Cell(f"{one.title}, {percent(one.margin)} left" if one.holds else f"{one.title}: does not hold", one.margin)


def _tightness(one: Constraint) -> tuple[bool, float]:
    return one.holds, math.inf if math.isnan(one.margin) else one.margin


def _range(entry: Any, value: Any) -> tuple[str, str]:
    """Return what a parameter was chosen from, and which end of it the value is at."""
    told = entry if isinstance(entry, Mapping) else {"values": entry}
    low, high, values = told.get("from"), told.get("to"), told.get("values")
    if _is_number(low) and _is_number(high):
        spare = _AT_THE_END * (high - low)
        between = f"{said(low)} to {said(high)}" + (", logarithmic" if told.get("log") else "")
        return between, _end(value, low + spare, high - spare)
    if isinstance(values, list | tuple):
        ordered = len(values) > 1 and all(map(_is_number, values))
        return said(values), _end(value, min(values), max(values)) if ordered else UNDEFINED
    return (UNDEFINED if values is None else said(values)), UNDEFINED


def _end(value: Any, low: float, high: float) -> str:
    if not _is_number(value):
        return UNDEFINED
    return "lower end" if value <= low else "upper end" if value >= high else "no"


def _is_number(value: Any) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _key(value: Any) -> float | None:
    return float(value) if _is_number(value) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number_cell(value: float | None, unit: str = "") -> Cell:
    if value is None or not math.isfinite(value):
        return Cell(number(value))
    return Cell(f"{number(value)} {unit}".rstrip(), float(value))

"""A design in words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from scenetruth.design.optimise.confirm.intervals import interval_at
from scenetruth.design.optimise.parts import Discrepancy, Interval, Objective, Order, Rig, Rule, Sensitivity

__all__ = ["MUCH_TOLD", "order_words", "told_value", "words_of"]

_MOST_TOLD = 3
MUCH_TOLD = 0.9
"""Share of a region that must be told, or else it is said that it is not."""


def words_of(
    objectives: Sequence[Objective],
    rig: Rig,
    sensitivities: Sequence[Sensitivity],
    discrepancies: Sequence[Discrepancy],
    rules: Sequence[Rule],
    orders: Sequence[Order] = (),
) -> tuple[str, ...]:
    """Return a design in words, a line each.

    Parameters
    ----------
    objectives, sensitivities, discrepancies, rules, orders
        As of a design.
    rig
        The recommended rig.
    """
    values = ", ".join(f"{name} = {told_value(value)}" for name, value in rig.parameters.items())
    found = [f"recommended, rig {rig.number}: {values}", *_reached(objectives, rig)]
    if rig.limits:
        found.append(f"limits: {rig.limits}")
    found += _changed(objectives, sensitivities)
    found += _compared(discrepancies)
    found += order_words(objectives, orders)
    broken = [one.title for one in rules if not one.holds]
    return tuple(found + ([f"rules of thumb that are not kept: {', '.join(broken)}"] if broken else []))


def told_value(value: Any) -> str:
    """Return a value of a parameter as people write it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def order_words(objectives: Sequence[Objective], orders: Sequence[Order]) -> Iterator[str]:
    """Say whether simulated rigs keep the order of their predictions, objective by objective.

    Parameters
    ----------
    objectives, orders
        As of a design.
    """
    for objective in objectives:
        own = [one for one in orders if one.objective == objective.title]
        count = Counter(one.verdict for one in own)
        if own:
            yield (
                f"{objective.title}: of {len(own)} pair{'s' if len(own) > 1 else ''} of simulated rigs, "
                f"{count['kept']} keep the order that was predicted, {count['swapped']} have swapped it, and of "
                f"{count['cannot be told']} it cannot be told from {min(one.seeds for one in own)} seeds"
            )


def _changed(objectives: Sequence[Objective], sensitivities: Sequence[Sensitivity]) -> Iterator[str]:
    told = [one for one in sensitivities if math.isfinite(one.ten_percent)]
    for objective in objectives:
        own = sorted((one for one in told if one.objective == objective.title), key=lambda one: -abs(one.ten_percent))
        parts = [f"{one.parameter} {_signed(one.ten_percent)} ({_signed(one.ten_percent_less)})" for one in own]
        if parts:
            most = ", ".join(parts[:_MOST_TOLD])
            yield f"10 % more (less) of each parameter changes {objective.title.lower()} by: {most}"


def _signed(share: float) -> str:
    return f"{100 * share:+.1f} %" if math.isfinite(share) else "–"


def _compared(discrepancies: Sequence[Discrepancy]) -> Iterator[str]:
    notable = [one for one in discrepancies if one.notable]
    if notable:
        yield f"{len(notable)} of {len(discrepancies)} simulated figures differ notably from their prediction"
    elif discrepancies:
        yield f"all {len(discrepancies)} simulated figures agree with their prediction, as far as seeds tell"
    yield from (f"rig {one.rig}: {one.says}" for one in notable)


def _reached(objectives: Sequence[Objective], rig: Rig) -> Iterator[str]:
    for one in objectives:
        told = f"{one.title}: {one.told_in}, predicted {rig.predicted[one.title]:.3g} {one.unit}"
        found = rig.simulated.get(one.title)
        figure, known = rig.predicted[one.title], "predicted"
        if found is not None:
            figure, known = found.number, "simulated"
            told += f", simulated {found.number:.3g} ({_seeds(found)}{_beside(rig, one)})"
            if rig.density(one.title) < MUCH_TOLD:
                told += f"; only {100 * rig.density(one.title):.0f} % of the pixels are told"
        if one.wanted is not None:
            reached = "reached" if figure <= one.wanted else "NOT reached"
            if found is not None and figure <= one.wanted < found.high:
                reached = "reached, but another recording may miss it"
            told += f"; wanted {one.wanted:g}: {reached} ({known})"
        yield told


def _seeds(found: Interval) -> str:
    if found.seeds < 2 or not math.isfinite(found.low):
        return f"from {'one seed' if found.seeds == 1 else f'{found.seeds} seeds'}: no interval"
    return f"another recording: {found.low:.3g} to {found.high:.3g} with 95 %, from {found.seeds} seeds"


def _beside(rig: Rig, objective: Objective) -> str:
    """Return the rms error where it is not what the objective is of: it tells of places that are far off."""
    rms = interval_at(rig, objective.title, "rms")
    return f"; rms error {rms.number:.3g}" if objective.statistic != "rms" and rms.seeds else ""

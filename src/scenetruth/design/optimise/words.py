"""A design in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from scenetruth.design.optimise.parts import Discrepancy, Objective, Rig, Rule, Sensitivity

__all__ = ["told_value", "words_of"]

_MOST_TOLD = 3


def words_of(
    objectives: Sequence[Objective],
    rig: Rig,
    sensitivities: Sequence[Sensitivity],
    discrepancies: Sequence[Discrepancy],
    rules: Sequence[Rule],
) -> tuple[str, ...]:
    """Return a design in words, a line each.

    Parameters
    ----------
    objectives, sensitivities, discrepancies, rules
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
    broken = [one.title for one in rules if not one.holds]
    return tuple(found + ([f"rules of thumb that are not kept: {', '.join(broken)}"] if broken else []))


def told_value(value: Any) -> str:
    """Return a value of a parameter as people write it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _changed(objectives: Sequence[Objective], sensitivities: Sequence[Sensitivity]) -> Iterator[str]:
    told = [one for one in sensitivities if math.isfinite(one.ten_percent)]
    for objective in objectives:
        own = sorted((one for one in told if one.objective == objective.title), key=lambda one: -abs(one.ten_percent))
        parts = [f"{one.parameter} {100 * one.ten_percent:+.1f} %" for one in own[:_MOST_TOLD]]
        if parts:
            yield f"10 % more of each parameter changes {objective.title.lower()} by: {', '.join(parts)}"


def _compared(discrepancies: Sequence[Discrepancy]) -> Iterator[str]:
    notable = [one for one in discrepancies if one.notable]
    if notable:
        yield f"{len(notable)} of {len(discrepancies)} simulated figures differ notably from their prediction"
    elif discrepancies:
        yield f"all {len(discrepancies)} simulated figures agree with their prediction, as far as seeds tell"
    yield from (f"rig {one.rig}: {one.says}" for one in notable)


def _reached(objectives: Sequence[Objective], rig: Rig) -> Iterator[str]:
    for one in objectives:
        told = f"{one.title}: predicted {rig.predicted[one.title]:.3g} {one.unit}"
        found = rig.simulated.get(one.title)
        figure, known = rig.predicted[one.title], "predicted"
        if found is not None:
            figure, known = found.number, "simulated"
            told += (
                f", simulated {found.number:.3g} (rms against the truth; {found.low:.3g} to {found.high:.3g} with 95 %"
            )
            told += f" in another recording, from {found.seeds} seeds)"
        if one.wanted is not None:
            reached = "reached" if figure <= one.wanted else "NOT reached"
            if found is not None and figure <= one.wanted < found.high:
                reached = "reached, but another recording may miss it"
            told += f"; wanted {one.wanted:g}: {reached} ({known})"
        yield told

"""The answer in a few words: what the recommended rig reaches, and what one must know before building."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from scenetruth.design.optimise.result import Design, Interval, Objective
from scenetruth.design.page.words import interval, length, number, signed_percent

__all__ = ["Reached", "orders_of", "reached_of", "sensitivity_words", "warnings_of"]

_MOST_WORDS = 3


@dataclass(frozen=True)
class Reached:
    """What the recommended rig reaches of an objective.

    Parameters
    ----------
    title
        The objective.
    figure, unit
        The number that counts: of simulations if there are any, else predicted.
    source
        Where it is from, with its interval.
    verdict
        Whether it is what was wanted; empty if nothing was.
    """

    title: str
    figure: str
    unit: str
    source: str
    verdict: str


def reached_of(design: Design) -> list[Reached]:
    """Return what the recommended rig reaches, objective by objective."""
    found = []
    for objective in design.objectives:
        predicted = design.recommended.predicted[objective.title]
        simulated = design.recommended.simulated.get(objective.title)
        if simulated is None:
            source = "predicted standard deviation; not simulated"
            figure = predicted
        else:
            between = interval(simulated.low, simulated.high)
            told = f"95 %: {between}; " if between else ""
            several = "recording" if simulated.seeds == 1 else "recordings"
            source = f"rms error in {simulated.seeds} simulated {several} ({told}predicted {number(predicted)})"
            figure = simulated.number
        verdict = _verdict(objective, predicted, simulated)
        found.append(Reached(objective.title, number(figure), objective.unit, source, verdict))
    return found


def _verdict(objective: Objective, predicted: float, simulated: Interval | None) -> str:
    wanted = objective.wanted
    if wanted is None:
        return ""
    aim = f"Wanted: {length(wanted)} {objective.unit}"
    if simulated is None:
        return f"{aim}. {'Reached' if predicted <= wanted else 'Not reached'} by prediction alone."
    if not simulated.number <= wanted:
        return f"{aim}. Not reached."
    if math.isfinite(simulated.high) and simulated.high > wanted:
        return f"{aim}. Reached in the mean, but the interval goes beyond."
    return f"{aim}. Reached{', with all of the interval' if math.isfinite(simulated.high) else ''}."


def warnings_of(design: Design) -> list[tuple[str, str]]:
    """Return what must be known before anything else: words, and the part of the page that tells more."""
    told = []
    broken = [one for one in design.recommended.constraints if not one.holds]
    if broken:
        names = ", ".join(one.title for one in broken)
        told.append((f"The recommended rig does not keep every constraint: {names}.", "constraints"))
    if not design.recommended.is_confirmed:
        told.append(("The recommended rig was not simulated: its figures are predictions.", "agreement"))
    for objective in design.objectives:
        figure = design.recommended.predicted[objective.title]
        if objective.title in design.recommended.simulated:
            figure = design.recommended.simulated[objective.title].number
        if objective.wanted is not None and not figure <= objective.wanted:
            aim = f"{number(figure)} {objective.unit}, and not {length(objective.wanted)} {objective.unit}"
            told.append(
                (f"The recommended rig does not reach what is wanted. {objective.title}: {aim}.", "alternatives")
            )
    notable = [one for one in design.discrepancies if one.notable]
    if notable:
        count = f"{len(notable)} of {len(design.discrepancies)}"
        own = sum(one.rig == design.recommended.number for one in notable)
        which = f", {own} of them at the recommended rig" if own else ""
        told.append((f"Prediction and simulation differ notably in {count} figures{which}.", "agreement"))
    return told


def orders_of(design: Design) -> list[str]:
    """Say whether rigs keep their order from prediction to simulation, objective by objective."""
    told = []
    for objective in design.objectives:
        known = [rig for rig in design.front if objective.title in rig.simulated]
        pairs = list(
            combinations([(r.predicted[objective.title], r.simulated[objective.title].number) for r in known], 2)
        )
        if pairs:
            kept = sum((a[0] - b[0]) * (a[1] - b[1]) >= 0 for a, b in pairs)
            told.append(
                f"{objective.title}: {kept} of {len(pairs)} pairs of the {len(known)} simulated rigs of the front "
                "keep the order that was predicted."
            )
    return told


def sensitivity_words(design: Design) -> list[str]:
    """Say what 10 % more of the parameters that matter most does, objective by objective."""
    told = []
    for objective in design.objectives:
        own = [
            one
            for one in design.sensitivities
            if one.objective == objective.title and math.isfinite(one.ten_percent) and one.ten_percent != 0
        ]
        own = sorted(own, key=lambda one: -abs(one.ten_percent))[:_MOST_WORDS]
        if own:
            parts = [
                f"10 % more {one.parameter} changes it by {signed_percent(one.ten_percent)} "
                f"({'better' if one.ten_percent < 0 else 'worse'})"
                for one in own
            ]
            told.append(f"{objective.title}: {_listed(parts)}.")
    return told


def _listed(parts: Sequence[str]) -> str:
    return "; ".join(parts)

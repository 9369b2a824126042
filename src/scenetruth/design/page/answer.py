"""The answer in a few words: what the recommended rig reaches, and what one must know before building."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scenetruth.design.optimise.confirm.intervals import interval_at
from scenetruth.design.optimise.result import Design, Objective
from scenetruth.design.optimise.words import MUCH_TOLD
from scenetruth.design.page.words import interval, length, number, signed_percent

__all__ = ["Reached", "reached_of", "sensitivity_words", "warnings_of"]

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
            source = f"predicted {objective.told_in}; not simulated"
            figure = predicted
        else:
            between = interval(simulated.low, simulated.high)
            told = f"95 %: {between}; " if between else ""
            several = "recording" if simulated.seeds == 1 else "recordings"
            rms = interval_at(design.recommended, objective.title, "rms")
            beside = f"; rms error {number(rms.number)}" if objective.statistic != "rms" and rms.seeds else ""
            told += f"predicted {number(predicted)}{beside}"
            source = f"{objective.told_in} in {simulated.seeds} simulated {several} ({told})"
            figure = simulated.number
        verdict = _verdict(design, objective)
        found.append(Reached(objective.title, number(figure), objective.unit, source, verdict))
    return found


def _verdict(design: Design, objective: Objective) -> str:
    wanted, title = objective.wanted, objective.title
    predicted, simulated = design.recommended.predicted[title], design.recommended.simulated.get(title)
    if wanted is None:
        return ""
    aim = f"Wanted: {length(wanted)} {objective.unit}"
    if simulated is None:
        return f"{aim}. {'Reached' if predicted <= wanted else 'Not reached'} by prediction alone."
    if not simulated.number <= wanted:
        return f"{aim}. Not reached."
    if math.isfinite(simulated.high) and simulated.high > wanted:
        told = "Reached in the mean, but the interval goes beyond."
    else:
        told = f"Reached{', with all of the interval' if math.isfinite(simulated.high) else ''}."
    rms = interval_at(design.recommended, title, "rms")
    return f"{aim}. {told}" + (" The rms error is beyond." if rms.number > wanted else "")


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
        told += _far_off(design, objective, figure)
        if design.recommended.density(objective.title) < MUCH_TOLD:
            share = f"{100 * design.recommended.density(objective.title):.0f} %"
            words = f"{objective.title}: the method tells only {share} of the pixels; the figures are of these."
            told.append((words, "agreement"))
    notable = [one for one in design.discrepancies if one.notable]
    if notable:
        count = f"{len(notable)} of {len(design.discrepancies)}"
        own = sum(one.rig == design.recommended.number for one in notable)
        which = f", {own} of them at the recommended rig" if own else ""
        told.append((f"Prediction and simulation differ notably in {count} figures{which}.", "agreement"))
    return told


def _far_off(design: Design, objective: Objective, figure: float) -> list[tuple[str, str]]:
    """Warn of places that are so far off that the rms error misses what the objective's statistic reaches."""
    rms = interval_at(design.recommended, objective.title, "rms")
    wanted = objective.wanted
    if objective.statistic == "rms" or wanted is None or not figure <= wanted or not rms.number > wanted:
        return []
    words = f"{objective.title}: some places are far off. The {objective.told_in} is {number(figure)} {objective.unit},"
    return [(f"{words} but the rms error {number(rms.number)} {objective.unit}.", "alternatives")]


def sensitivity_words(design: Design) -> list[str]:
    """Say what 10 % more and less of the parameters that matter most does, objective by objective."""
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
                f"({'better' if one.ten_percent < 0 else 'worse'}), 10 % less by {signed_percent(one.ten_percent_less)}"
                for one in own
            ]
            told.append(f"{objective.title}: {_listed(parts)}.")
    return told


def _listed(parts: Sequence[str]) -> str:
    return "; ".join(parts)

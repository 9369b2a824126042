"""Rigs from their evaluations, and what ten percent more or less of each parameter does to them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from scenetruth.design.optimise.answer.limits import limits_of
from scenetruth.design.optimise.catalogues.load import Entries
from scenetruth.design.optimise.goal.prepare import Prepared
from scenetruth.design.optimise.parts import Rig
from scenetruth.design.optimise.rig.build import build
from scenetruth.design.optimise.rig.evaluate import Evaluation, Task, evaluate
from scenetruth.scene import scene_from_plain

__all__ = ["rig_of", "ten_percent_of"]

_OTHER = "another length"


def rig_of(number: int, one: Evaluation, prepared: Prepared) -> Rig:
    """Return the rig of an evaluation.

    Parameters
    ----------
    number
        Its number among all predictions.
    one
        The evaluation.
    prepared
        What is designed.
    """
    task = prepared.task
    built = build(task.base, one.values)
    plain = scene_from_plain(built.plain).to_plain()
    chosen = [entry for entry in (built.lens, built.camera, built.stage) if entry is not None]
    prices = [entry.price_eur for entry in chosen]
    price = sum(each for each in prices if each is not None) if prices and None not in prices else None
    limits = limits_of(one, prepared.space, task.objectives)
    return Rig(number, dict(one.values), plain, dict(one.predicted), {}, one.constraints, price, limits)


def ten_percent_of(one: Evaluation, prepared: Prepared, factor: float = 1.1) -> dict[tuple[str, str], float]:
    """Return by what share objectives change for ten percent more of each parameter, by objective and parameter.

    Of whole numbers, at least one more or less is taken, and what ten percent would do follows on logarithmic scales.
    Of a lens, it is the focal length. What cannot be made, or has no size, is left out.

    Parameters
    ----------
    one
        The rig.
    prepared
        What is designed.
    factor
        What parameters are multiplied with: 0.9 for ten percent less.
    """
    task, found = prepared.task, dict[tuple[str, str], float]()
    # Not the prediction that is kept: it may be of an earlier version.
    here = evaluate(task, one.values)
    for parameter in prepared.space.parameters:
        value = one.values[parameter.name]
        changed = _changed(task, parameter.name, value, factor)
        if changed is None:
            continue
        other, new, changed_by = changed
        told = evaluate(other, {**one.values, parameter.name: new})
        for objective in task.objectives:
            before, after = here.predicted[objective.title], told.predicted[objective.title]
            if 0 < before < math.inf and 0 < after < math.inf:
                power = math.log(factor) / math.log(changed_by)
                found[objective.title, parameter.name] = (after / before) ** power - 1
    return found


def _changed(task: Task, name: str, value: Any, factor: float) -> tuple[Task, Any, float] | None:
    """Return what evaluates a changed parameter, its new value, and by what it changed; None if it has no size."""
    if name == "lens":
        entry = task.base.entries.lenses[value]
        other = entry.model_copy(update={"focal_length_mm": factor * entry.focal_length_mm})
        entries = task.base.entries
        more = Entries({**entries.lenses, _OTHER: other}, entries.cameras, entries.stages)
        return replace(task, base=replace(task.base, entries=more)), _OTHER, factor
    if isinstance(value, bool) or not isinstance(value, int | float) or value == 0:
        return None
    if isinstance(value, int):
        rounded = round(factor * value)
        new = max(rounded, value + 1) if factor > 1 else min(rounded, value - 1)
        return (task, new, new / value) if new > 0 and value > 0 else None
    return task, factor * value, factor

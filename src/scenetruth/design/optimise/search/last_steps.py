"""The last steps of the search: from the best rigs to better ones nearby, in ever smaller steps.

Three kinds of step take turns. Single parameters are changed. Differences between good rigs are added to the best one
(differential evolution; R. Storn and K. Price, Journal of Global Optimization 11, 1997): where a constraint is used up,
good rigs lie along it, and so do these steps. Rigs that would be better but pass a constraint are drawn back by halves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenetruth.design.optimise.parts import Objective
from scenetruth.design.optimise.rig.evaluate import Evaluation
from scenetruth.design.optimise.rig.space import Parameter, Space
from scenetruth.design.optimise.search.front import front_of, with_alternatives
from scenetruth.design.optimise.search.ledger import Ledger

__all__ = ["last_steps"]

_FIRST, _LEAST = 0.2, 0.002
_STARTS = 2
_POOL = 16
_SINGLE, _DIFFERENCES, _HALVES = 8, 12, 4
_CROSSED, _OTHER_CHOICE = 0.7, 0.15
_PATIENCE = 3
"""Rounds without a better rig after which the next start has its turn."""


def last_steps(ledger: Ledger, space: Space, objectives: Sequence[Objective], count: int, seed: int) -> None:
    """Step from the best rigs to better ones: by the product of the objectives, and by each of them.

    Parameters
    ----------
    ledger
        Where predictions come from.
    space, objectives
        What is designed.
    count
        How many predictions, at most.
    seed
        Of what is drawn.
    """
    end = len(ledger) + count
    generator = np.random.default_rng(seed)
    goals: list[tuple[Objective, ...]] = [tuple(objectives)]
    goals += [(one,) for one in objectives] if len(objectives) > 1 else []
    for number, wanted in enumerate(goals):
        starts = _starts(ledger.evaluations, wanted, space)
        for place, start in enumerate(starts):
            share = (end - len(ledger)) // ((len(goals) - number) * (len(starts) - place))
            _descend(ledger, space, wanted, start, len(ledger) + share, generator)


def _starts(found: Sequence[Evaluation], wanted: Sequence[Objective], space: Space) -> list[Evaluation]:
    if len(wanted) == 1:
        best = front_of(found, wanted)
        return [found[number] for number in with_alternatives(found, wanted, space, best, _STARTS)] if best else []
    return _pool(found, wanted)[:1]


def _pool(found: Sequence[Evaluation], wanted: Sequence[Objective]) -> list[Evaluation]:
    held = [one for one in found if one.holds]
    return sorted(held, key=lambda one: _worth(one, wanted))[:_POOL]


def _worth(one: Evaluation, wanted: Sequence[Objective]) -> float:
    """Return what is to be small: logarithms of objectives, whether constraints hold or not."""
    return sum(math.log(one.predicted[each.title]) if one.predicted[each.title] > 0 else math.inf for each in wanted)


def _descend(
    ledger: Ledger,
    space: Space,
    wanted: Sequence[Objective],
    start: Evaluation,
    end: int,
    generator: np.random.Generator,
) -> None:
    best, step, idle = start, _FIRST, 0
    passed: list[list[float]] = []
    while len(ledger) < end and idle < _PATIENCE:
        place = space.point(best.values)
        pool = [space.point(one.values) for one in _pool(ledger.evaluations, wanted)]
        tried = [_halfway(place, other, space) for other in passed[:_HALVES]]
        tried += [_single(place, space, step, generator) for _ in range(_SINGLE)]
        tried += [_difference(place, pool, space, generator) for _ in range(_DIFFERENCES)]
        tried = tried[: end - len(ledger)]
        found = ledger.ask(tried, "last steps")
        worth = _worth(best, wanted)
        held = [one for one in found if one.holds and _worth(one, wanted) < worth - 1e-6]
        near = [
            (one.excess, point)
            for one, point in zip(found, tried, strict=True)
            if not one.holds and one.constraints and _worth(one, wanted) < worth
        ]
        passed = [point for _, point in sorted(near)]
        if held:
            best, idle = min(held, key=lambda one: _worth(one, wanted)), 0
        elif step > _LEAST:
            step /= 2
        else:
            idle += 1


def _halfway(place: Sequence[float], other: Sequence[float], space: Space) -> list[float]:
    """Return what lies between two rigs; its choices are those of the second."""
    return [
        b if parameter.choices else (a + b) / 2 for a, b, parameter in zip(place, other, space.parameters, strict=True)
    ]


def _single(place: Sequence[float], space: Space, step: float, generator: np.random.Generator) -> list[float]:
    number = int(generator.integers(len(space)))
    found = list(place)
    found[number] = _stepped(space.parameters[number], place[number], step, generator)
    return found


def _stepped(parameter: Parameter, unit: float, step: float, generator: np.random.Generator) -> float:
    levels = parameter.levels
    if parameter.choices:
        return (int(generator.integers(levels)) + 0.5) / levels
    side = 1.0 if generator.random() < 0.5 else -1.0
    if levels:
        return _inside(unit + side * max(step, 1 / levels))
    return _inside(unit + side * step)


def _difference(
    place: Sequence[float], pool: Sequence[Sequence[float]], space: Space, generator: np.random.Generator
) -> list[float]:
    """Return the best rig with the difference of two good ones added."""
    one, other, third = (pool[int(generator.integers(len(pool)))] for _ in range(3))
    size = generator.uniform(0.3, 1.2)
    found = []
    for number, parameter in enumerate(space.parameters):
        unit = place[number]
        if parameter.choices:
            found.append(third[number] if generator.random() < _OTHER_CHOICE else unit)
        elif generator.random() < _CROSSED:
            found.append(_inside(unit + size * (one[number] - other[number])))
        else:
            found.append(unit)
    return found


def _inside(unit: float) -> float:
    return min(max(unit, 0.0), 1.0)

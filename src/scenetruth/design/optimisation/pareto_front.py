"""The Pareto front: non-dominated candidates, the recommended one, alternatives, and which are simulated and shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimisation.design_records import Objective
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation

__all__ = ["add_alternatives", "find_pareto_front", "select_distinguishable", "select_recommended", "thin_front"]

Array = NDArray[np.float64]

_APART = 0.2
"""Rigs are other rigs if a parameter differs by this share of its range, or a choice is another."""
_MOST_FACTOR = 3.0
_DISTINGUISHABLE = math.log(1.3)
"""Rigs that differ by less are within what predictions know. With five seeds, simulations tell factors of 1.2 to 1.4:
of rigs for the growth of a leaf, paired logarithms scatter by 0.17 (growth) and 0.27 (depth)."""
_AS_GOOD = 1.1
"""Worst factors that differ by less are as good as each other."""


def find_pareto_front(found: Sequence[Evaluation], objectives: Sequence[Objective]) -> list[int]:
    """Return the numbers of the rigs on the front, by the first objective; with one objective, of its best."""
    held = [number for number, one in enumerate(found) if one.holds]
    if not held:
        return []
    worths = np.log([[found[number].predicted[one.title] for one in objectives] for number in held])
    kept: list[int] = []
    for k in np.lexsort(worths.T[::-1]):
        if not any((worths[other] <= worths[k]).all() for other in kept):
            kept.append(int(k))
    return [held[k] for k in kept]


def add_alternatives(
    found: Sequence[Evaluation],
    objectives: Sequence[Objective],
    space: DesignSpace,
    front: Sequence[int],
    count: int = 6,
) -> list[int]:
    """Return the front, and if it has few rigs, the best of those that differ from it and from each other."""
    chosen = list(front)
    least = {one.title: min(found[number].predicted[one.title] for number in front) for one in objectives}
    worths = {
        number: max(one.predicted[each.title] / least[each.title] for each in objectives)
        for number, one in enumerate(found)
        if one.holds
    }
    end = _MOST_FACTOR * min(worths[number] for number in front)
    places = [space.point(found[number].values) for number in chosen]
    for number in sorted(worths, key=lambda number: worths[number]):
        if len(chosen) >= count or worths[number] > end:
            break
        place = space.point(found[number].values)
        if all(_differ(place, other, space) for other in places):
            chosen.append(number)
            places.append(place)
    return chosen


def _differ(one: Sequence[float], other: Sequence[float], space: DesignSpace) -> bool:
    return any(
        (parameter.choices and a != b) or abs(a - b) > _APART
        for a, b, parameter in zip(one, other, space.parameters, strict=True)
    )


def compute_target_ratios(
    figures: Mapping[str, float], objectives: Sequence[Objective], least: Mapping[str, float]
) -> list[float]:
    """Return how far a rig is from what is wanted, or from the best that there is: factors, one for each objective."""
    return [figures[one.title] / (one.wanted if one.wanted is not None else least[one.title]) for one in objectives]


def select_recommended(figures: Sequence[Mapping[str, float]], objectives: Sequence[Objective]) -> int:
    """Return the index of the rig to recommend: the least worst ratio to the best value, then least product."""
    least = {
        one.title: min((each[one.title] for each in figures if math.isfinite(each[one.title])), default=math.inf)
        for one in objectives
    }

    factors = [compute_target_ratios(each, objectives, least) for each in figures]
    worst = [max(told) if all(map(math.isfinite, told)) else math.inf for told in factors]
    good = [number for number, one in enumerate(worst) if one <= _AS_GOOD * min(worst)]
    return min(good, key=lambda number: (math.prod(factors[number]), worst[number]))


def select_distinguishable(figures: Array, on_front: int, count: int) -> list[int]:
    """Return which rigs to simulate: the first, then those far enough from it and each other for simulations to tell.

    Of the front, the farthest come first; then alternatives in their order. If these are too few, the rest follows.

    ``figures``: Logarithms of the objectives, shape (rigs, objectives): the front's first.
    """
    chosen = [0][:count]

    def away(number: int) -> float:
        return min(float(np.abs(figures[number] - figures[one]).max()) for one in chosen)

    left = list(range(1, len(figures)))
    while left and len(chosen) < count:
        ahead = [number for number in left if number < on_front and away(number) > _DISTINGUISHABLE]
        behind = [number for number in left if number >= on_front and away(number) > _DISTINGUISHABLE]
        if ahead or not behind:
            best = max(ahead or left[: max(1, sum(number < on_front for number in left))], key=away)
        else:
            best = behind[0]
        chosen.append(best)
        left.remove(best)
    return chosen


def thin_front(figures: Array, count: int, first: int) -> list[int]:
    """Return some points of a front that are far from each other, ends first.

    ``figures``: Logarithms of the objectives, shape (points, objectives).
    """
    spread = np.ptp(figures, axis=0)
    scaled = figures / np.where(spread > 0, spread, 1.0)
    chosen = [first]
    ends = [int(np.argmin(figures[:, k])) for k in range(figures.shape[1])]
    while len(chosen) < min(count, len(figures)):
        left = [k for k in ends if k not in chosen]
        if left and figures.shape[1] > 1:
            chosen.append(left[0])
            continue
        away = np.min([np.abs(scaled - scaled[k]).max(axis=1) for k in chosen], axis=0)
        away[chosen] = -1.0
        chosen.append(int(np.argmax(away)))
    return chosen

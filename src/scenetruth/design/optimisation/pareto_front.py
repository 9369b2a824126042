"""The Pareto front, and the selection of recommended, alternative, simulated and displayed candidates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimisation.design_records import Objective
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation

__all__ = ["add_alternatives", "find_pareto_front", "select_distinguishable", "select_recommended", "thin_front"]

Array = NDArray[np.float64]

_APART = 0.2  # smallest difference between distinct rigs: a fraction of the range of a parameter, or a different choice
_MOST_FACTOR = 3.0
_DISTINGUISHABLE = math.log(1.3)
"""Smallest difference of log objectives beyond the uncertainty of predictions. Simulations with five seeds resolve
factors of 1.2 to 1.4: for rigs of leaf growth, paired logarithms scatter by 0.17 (growth) and 0.27 (depth)."""
_AS_GOOD = 1.1  # factor within which worst ratios count as equal


def find_pareto_front(found: Sequence[Evaluation], objectives: Sequence[Objective]) -> list[int]:
    """Return the indices of the non-dominated feasible candidates, sorted by the first objective."""
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
    """Return the front; if it is small, also the best candidates that differ from it and from each other."""
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
    """Return the ratio of each objective to its target, or to the best value without a target."""
    return [figures[one.title] / (one.wanted if one.wanted is not None else least[one.title]) for one in objectives]


def select_recommended(figures: Sequence[Mapping[str, float]], objectives: Sequence[Objective]) -> int:
    """Return the index of the recommended candidate: smallest worst ratio, then smallest product of ratios."""
    least = {
        one.title: min((each[one.title] for each in figures if math.isfinite(each[one.title])), default=math.inf)
        for one in objectives
    }

    factors = [compute_target_ratios(each, objectives, least) for each in figures]
    worst = [max(values) if all(map(math.isfinite, values)) else math.inf for values in factors]
    good = [number for number, one in enumerate(worst) if one <= _AS_GOOD * min(worst)]
    return min(good, key=lambda number: (math.prod(factors[number]), worst[number]))


def select_distinguishable(figures: Array, on_front: int, count: int) -> list[int]:
    """Return the indices of the rigs to simulate: the first, then rigs with resolvable differences.

    The most distant rigs of the front come first, then the alternatives in order, then the rest. ``figures``:
    Logarithms of the objectives, shape (rigs, objectives); the front comes first.
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
    """Return the indices of ``count`` well separated points, ends first, of a front (points, log objectives)."""
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

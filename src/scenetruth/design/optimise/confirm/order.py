"""Whether simulations keep the order of predicted rigs: paired differences over seeds, which are the same for all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from scenetruth.design.optimise.parts import Objective, Order, Rig

__all__ = ["order_of", "orders_of"]

_LEVEL = 0.975


def orders_of(rigs: Sequence[Rig], objectives: Sequence[Objective]) -> tuple[Order, ...]:
    """Return all pairs of rigs that were simulated, objective by objective.

    Parameters
    ----------
    rigs
        Rigs; those that were not simulated are left out.
    objectives
        What is to be known.
    """
    found = [
        order_of(one, other, objective)
        for objective in objectives
        for one, other in combinations([rig for rig in rigs if objective.title in rig.simulated], 2)
        if one.predicted[objective.title] != other.predicted[objective.title]
    ]
    return tuple(found)


def order_of(one: Rig, other: Rig, objective: Objective) -> Order:
    """Judge a pair of rigs.

    A seed gives all rigs the same texture, and draws noise and errors of the stage from the same streams. What rigs
    have in common goes out of the differences of logarithms. Their mean is known to within t s / √n, with Student's t
    of n - 1 degrees of freedom and their standard deviation s.

    Parameters
    ----------
    one, other
        The rigs, with figures of the same seeds.
    objective
        What is compared, by its statistic.
    """
    from scipy.special import stdtrit

    title = objective.title
    better, worse = sorted((one, other), key=lambda rig: rig.predicted[title])
    figures = [rig.figures.get(title, {}).get(objective.statistic, ()) for rig in (better, worse)]
    pairs = [(a, b) for a, b in zip(*figures, strict=True) if 0 < a < math.inf and 0 < b < math.inf]
    predicted = worse.predicted[title] / better.predicted[title]
    if len(pairs) < 2:
        return Order(title, better.number, worse.number, predicted, math.nan, math.nan, math.nan, len(pairs), _UNKNOWN)
    logs = np.log([b / a for a, b in pairs])
    middle = float(logs.mean())
    half = float(stdtrit(len(logs) - 1, _LEVEL) * logs.std(ddof=1) / math.sqrt(len(logs)))
    verdict = "kept" if middle > half else "swapped" if middle < -half else _UNKNOWN
    low, factor, high = (math.exp(min(each, 700.0)) for each in (middle - half, middle, middle + half))
    return Order(title, better.number, worse.number, predicted, factor, low, high, len(logs), verdict)


_UNKNOWN = "cannot be told"

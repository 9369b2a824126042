"""Figures of several seeds, with the interval in which one further seed's figure lies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenetruth.design.optimise.parts import Interval, Rig

__all__ = ["interval_at", "interval_of"]

_LEVEL = 0.975


def interval_at(rig: Rig, title: str, statistic: str) -> Interval:
    """Return what simulations say of any statistic of a rig.

    Parameters
    ----------
    rig
        The rig.
    title
        The objective.
    statistic
        Key of `scenetruth.design.optimise.statistics.STATISTICS`.
    """
    figures = rig.figures.get(title, {}).get(statistic, ())
    return interval_of([one for one in figures if math.isfinite(one)])


def interval_of(values: Sequence[float]) -> Interval:
    """Return the root mean square of figures, and the interval of one further figure with 95 %.

    Logarithms of figures are taken for normal. The next of them lies within t s √(1 + 1/n) of their mean, with
    Student's t of n - 1 degrees of freedom and their standard deviation s.

    Parameters
    ----------
    values
        Positive figures, one of each seed.

    Examples
    --------
    >>> found = interval_of([0.9, 1.0, 1.1, 1.0])
    >>> round(found.number, 3), round(found.low, 2), round(found.high, 2), found.seeds
    (1.002, 0.75, 1.34, 4)
    """
    from scipy.special import stdtrit

    each = np.asarray(values, dtype=np.float64)
    count = len(each)
    if not count:
        return Interval(math.nan, math.nan, math.nan, 0)
    number = float(np.sqrt(np.mean(each**2)))
    if count < 2 or not (each > 0).all():
        return Interval(number, math.nan, math.nan, count)
    logs = np.log(each)
    half = float(stdtrit(count - 1, _LEVEL) * logs.std(ddof=1) * math.sqrt(1 + 1 / count))
    middle = float(logs.mean())
    return Interval(number, math.exp(middle - half), math.exp(min(middle + half, 700.0)), count)

"""How much of a wave is left, and the period at which too much is lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_LEFT", "crossings", "share_left", "share_of_size"]

LEAST_LEFT = 0.9
"""A period is resolved where at least so much of an amplitude is left."""

_LEAST_LOG = 0.05
"""Less than this is as good as nothing, and may be negative."""

Map = NDArray[np.float64]


def share_left(found: Map, true: Map) -> float:
    """Return the share of a wave that is found: the slope of found over true, both without their mean.

    Parameters
    ----------
    found, true
        Values at the same pixels, shape (n,).

    Examples
    --------
    >>> wave = np.sin(np.arange(100.0))
    >>> round(share_left(0.8 * wave + 5, wave), 12)
    0.8
    """
    centred = true - true.mean()
    return float(np.sum((found - found.mean()) * centred) / np.sum(centred**2))


def share_of_size(found: Map, true: Map) -> float:
    """Return the share of a crest that is found: the slope of found over true, through the origin.

    Parameters
    ----------
    found, true
        Values at the same pixels, shape (n,).

    Examples
    --------
    >>> crest = np.array([0.8, 1.0, 0.8])
    >>> round(share_of_size(0.9 * crest, crest), 12)
    0.9
    """
    return float(np.sum(found * true) / np.sum(true**2))


def crossings(periods: Sequence[float], left: Sequence[float], least: float = LEAST_LEFT) -> tuple[float, float]:
    """Return the first and the last period at which a curve of shares crosses the least one, from long to short.

    Between two periods p, the logarithm of the share is a straight line over 1/p², as it is of a Gaussian window. NaN
    is nothing found: too little is left.

    Parameters
    ----------
    periods
        Periods in any order.
    left
        Share left at each.
    least
        The least share.

    Returns
    -------
    tuple of float
        Both are the same if the curve crosses once. 0 if enough is left at all periods, inf if at none: the period is
        then outside of what was measured.

    Examples
    --------
    >>> first, last = crossings([80, 40, 20], [0.98, 0.95, 0.85])
    >>> round(first, 3), first == last
    (25.512, True)
    """
    order = np.argsort(periods)[::-1]
    squares = np.asarray(periods, dtype=np.float64)[order] ** -2
    shares = np.nan_to_num(np.asarray(left, dtype=np.float64)[order], nan=0.0)
    enough = shares >= least
    if enough.all():
        return 0.0, 0.0
    if not enough[0] and not enough.any():
        return float("inf"), float("inf")
    places = np.flatnonzero(enough[1:] != enough[:-1])
    found = []
    for place in places:
        one, other = np.log(np.maximum(shares[place : place + 2], _LEAST_LOG)) - np.log(least)
        crossing = squares[place] + one / (one - other) * (squares[place + 1] - squares[place])
        found.append(float(crossing**-0.5))
    if not enough[0]:
        found.insert(0, float("inf"))
    return found[0], found[-1]

"""Percentiles near both ends of values that come in parts."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["outer_percentiles"]

Values = NDArray[np.float64]


def outer_percentiles(parts: Iterable[Values], percent: float, most: int) -> tuple[float, float]:
    """Return a low percentile and the high one opposite, exact, as of `numpy.nanpercentile` of all values together.

    Held are the values beyond the percentiles, about twice, and one part: with 0.1 percent on either side some
    thousandths of all values.

    Parameters
    ----------
    parts
        Values of any shape; NaN does not count.
    percent
        The low percentile, from 0 to 50; the high one is 100 - percent.
    most
        How many values there are in all parts at most.

    Examples
    --------
    >>> outer_percentiles([np.array([3.0, 1.0]), np.array([[2.0], [np.nan]])], 25, 4)
    (1.5, 2.5)
    """
    quantiles = np.true_divide((percent, 100 - percent), 100)
    count = int(most * quantiles[0]) + 3
    lowest, highest, known = _Least(count), _Least(count), 0
    for part in parts:
        values = part[~np.isnan(part)]
        known += values.size
        lowest.add(values)
        highest.add(-values)
    if known == 0:
        # NaN, with NumPy's warning.
        low, high = np.nanquantile([np.nan], quantiles).tolist()
        return low, high
    least, greatest = lowest.in_order(), -highest.in_order()

    def between(place: float) -> float:
        """Return the value at a place among all in their order, as a rule between two of them."""
        below = int(place)
        ranks = (below, min(below + 1, known - 1))
        pair = [least[rank] if rank < least.size else greatest[known - 1 - rank] for rank in ranks]
        return float(np.quantile(pair, place - below))

    return between((known - 1) * quantiles[0]), between((known - 1) * quantiles[1])


class _Least:
    """Keeps the least of the values that it is given, as many as asked for and some more."""

    def __init__(self, count: int) -> None:
        self._count, self._bound = count, np.inf
        self._kept: list[Values] = []
        self._size = 0

    def add(self, values: Values) -> None:
        self._kept.append(values[values <= self._bound])
        self._size += self._kept[-1].size
        if self._size > 2 * self._count:
            least = np.partition(np.concatenate(self._kept), self._count - 1)[: self._count]
            self._kept, self._size, self._bound = [least], least.size, float(least[-1])

    def in_order(self) -> Values:
        return np.sort(np.concatenate(self._kept))

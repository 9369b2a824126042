"""The disparities that are tried."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Hypotheses", "spread"]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Disparities in rising order: runs of even steps, with gaps between them."""

    values: NDArray[np.float64]
    """Disparity in columns per step of s, shape (k,)."""
    step: float
    """Distance of two neighbours within a run."""

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Whether a hypothesis follows that before it without a gap, shape (k + 1,); the ends do not."""
        near = np.diff(self.values) < 1.5 * self.step
        return np.concatenate([[False], near, [False]])

    def at(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the disparities at places between hypotheses, counted from the first."""
        nearest = np.rint(place).astype(np.int64)
        return self.values[nearest] + (place - nearest) * self.step


def spread(ranges: Iterable[tuple[float, float]], step: float) -> Hypotheses:
    """Return hypotheses over ranges of disparity; ranges that meet become one.

    Parameters
    ----------
    ranges
        First and last disparity of each.
    step
        Distance of two hypotheses.

    Examples
    --------
    >>> found = spread([(3.0, 4.0), (0.0, 0.5), (0.4, 1.0)], 0.5)
    >>> found.values.tolist(), found.joined.tolist()
    ([0.0, 0.5, 1.0, 3.0, 3.5, 4.0], [False, True, True, False, True, True, False])
    """
    places: set[int] = set()
    for first, last in ranges:
        places |= set(range(int(np.floor(first / step)), int(np.ceil(last / step)) + 1))
    return Hypotheses(np.array(sorted(places), dtype=np.float64) * step, step)

"""What became of each limit: kept or broken, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from scenetruth.testing.accuracy.limits import Limit
from scenetruth.testing.surroundings import Row

__all__ = ["Outcome", "judge"]

Values = Mapping[str, float | int | None]


@dataclass(frozen=True)
class Outcome:
    """A limit and what was found.

    Parameters
    ----------
    limit
        The limit; of a multiple of the bound, ``most`` is what it came to.
    found
        The statistic in the limit's units; None where it is undefined.
    density, count
        Of the quantity in the region: the share of pixels with a true value that are scored, and their number.
    note
        Why nothing could be found; empty if something was.
    """

    limit: Limit
    found: float | None
    density: float | None
    count: int
    note: str = ""

    @property
    def kept(self) -> bool:
        """Whether the statistic is defined and lies where it must."""
        found, limit = self.found, self.limit
        return not self.note and found is not None and limit.least <= found <= limit.most

    @property
    def times(self) -> float | None:
        """How much of the limit is used: above 1 it is broken; None where that cannot be told."""
        found, limit = self.found, self.limit
        if self.note or found is None:
            return None
        if math.isfinite(limit.least) and math.isfinite(limit.most):
            # Two bounds: how far from their middle, in halves of their distance.
            return _ratio(abs(2 * found - limit.least - limit.most), limit.most - limit.least)
        return _ratio(found, limit.most) if math.isfinite(limit.most) else _ratio(limit.least, found)

    def row(self, region: str) -> Row:
        """Return the outcome as plain values."""
        return {
            "quantity": self.limit.quantity,
            "statistic": self.limit.statistic,
            "region": region,
            "found": self.shown_found,
            "limit": self.shown_limit,
            "times": self.times,
            "kept": self.kept,
        }

    @property
    def shown_found(self) -> str:
        """What was found, with its unit, or why nothing was."""
        return self.note or self._spelled(self.found)

    @property
    def shown_limit(self) -> str:
        """The limit, with its unit."""
        limit = self.limit
        if math.isfinite(limit.least) and math.isfinite(limit.most) and limit.statistic != "bias":
            text = f"{limit.least:.4g} .. {self._spelled(limit.most)}"
        elif math.isfinite(limit.most):
            text = f"<= {self._spelled(limit.most)}"
        elif math.isfinite(limit.least):
            text = f">= {self._spelled(limit.least)}"
        else:
            return f"{limit.of_bound:g} x bound"
        return text if limit.of_bound is None else f"{text} ({limit.of_bound:g} x bound)"

    def _spelled(self, value: float | None) -> str:
        return f"{'undefined' if value is None else format(value, '.4g')} {self.limit.units}".strip()


def judge(limit: Limit, values: Values | None, bound: float | None = None) -> Outcome:
    """Hold a limit against a score.

    Parameters
    ----------
    limit
        The limit.
    values
        The statistics of its quantity in the region, in the score's units; None if the estimate has no such quantity.
    bound
        The rms of the bound over the pixels that are scored, in the score's units; None if it is not known.

    Returns
    -------
    Outcome
        What cannot be found is never kept.

    Examples
    --------
    >>> judge(Limit("depth", "rms", most=0.2, units="mm"), {"rms": 0.3, "density": 0.9, "count": 90}).kept
    False
    """
    if values is None:
        return Outcome(limit, None, None, 0, "the estimate has none")
    if limit.of_bound is not None and bound is not None:
        limit = replace(limit, most=limit.of_bound * bound * limit.factor)
    value, density, count = values.get(limit.statistic), values.get("density"), int(values.get("count") or 0)
    density = None if density is None else float(density)
    note = ""
    if not count:
        note = "no true value there" if density is None else "nothing is scored"
    elif value is None or not math.isfinite(value):
        spread = limit.statistic in ("calibration", "within_2_std")
        note = "no standard deviations" if spread else "undefined"
    elif limit.of_bound is not None and bound is None:
        note = "no bound there"
    found = None if value is None else float(value) * limit.factor
    return Outcome(limit, found, density, count, note)


def _ratio(one: float, other: float) -> float:
    if other == 0:
        return 0.0 if one == 0 else math.inf
    return one / other if other > 0 else math.inf

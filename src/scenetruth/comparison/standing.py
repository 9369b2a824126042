"""What methods stand at in a case: a figure for each, the median over values, on the pixels that all of them tell."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scenetruth.comparison.case import Case
from scenetruth.comparison.rows import BOUND, COMMON, OWN, Row

__all__ = ["Standing", "Standings"]


@dataclass(frozen=True)
class Standing:
    """Figures of methods that can be set side by side. Less is better: errors, or a period that is lost.

    Parameters
    ----------
    case
        The case.
    quantity, statistic
        What was measured.
    label
        Of which value, if it is of one; empty if it is the median over all.
    unit
        Unit of the figures.
    numbers
        A figure for each method, by label, that told anything; NaN if there is none at some value. Also the bound.
    """

    case: Case
    quantity: str
    statistic: str
    label: str
    unit: str
    numbers: Mapping[str, float]

    @property
    def of_methods(self) -> dict[str, float]:
        """The figures of those methods that told something, the best first."""
        told = {label: one for label, one in self.numbers.items() if label != BOUND and not math.isnan(one)}
        return dict(sorted(told.items(), key=lambda pair: pair[1]))


class Standings:
    """Figures of a comparison by what they are of.

    Parameters
    ----------
    rows
        All of its rows.
    methods
        Labels, in their order.
    """

    def __init__(self, rows: Sequence[Row], methods: Sequence[str]) -> None:
        self._methods = [*methods, BOUND]
        self._rows: dict[tuple[str, str, str], list[Row]] = {}
        for row in rows:
            self._rows.setdefault((row.case, row.quantity, row.statistic), []).append(row)

    def standing(self, case: Case, quantity: str, statistic: str, value: float | None = None) -> Standing | None:
        """Return what methods stand at; None if nobody told anything.

        Parameters
        ----------
        case, quantity, statistic
            What was measured.
        value
            At this value alone; the median over all if not given.
        """
        rows = self._rows.get((case.kind, quantity, statistic), ())
        rows = [row for row in rows if value is None or row.value == value]
        numbers = {}
        for label in self._methods:
            mine = [row for row in rows if row.method == label]
            figures = [abs(row.number) for row in mine if row.pixels == COMMON] or [
                abs(row.number) for row in mine if row.pixels == OWN
            ]
            if figures:
                # What there is not at some value is not counted.
                there = [one for one in figures if not math.isnan(one)]
                numbers[label] = statistics.median(there) if there else math.nan
        label = "" if value is None else case.label_of(value)
        return Standing(case, quantity, statistic, label, rows[0].unit, numbers) if numbers else None

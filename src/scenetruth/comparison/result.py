"""What a comparison has found: a tidy table of all figures, and a summary with a row for each method and case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.comparison.case import Case
from scenetruth.comparison.rows import BOUND, COMMON, OWN, Row

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Comparison"]


@dataclass(frozen=True)
class Comparison:
    """Figures of methods over the cases of a suite.

    Parameters
    ----------
    methods
        Their labels, in the order in which they were given.
    cases
        The cases.
    rows
        All figures.
    failures
        Why a method has given nothing, by case, value and label: lines to read.
    folder
        Where it lies; None if it was not kept.
    """

    methods: Sequence[str]
    cases: Sequence[Case] = field(repr=False)
    rows: Sequence[Row] = field(repr=False)
    failures: Sequence[str] = field(default=(), repr=False)
    folder: Path | None = None

    def to_frame(self) -> pd.DataFrame:
        """Return all figures, a row each; columns are the fields of `scenetruth.comparison.rows.Row`."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.rows], columns=list(Row.__dataclass_fields__))

    def figure(
        self,
        case: str,
        method: str,
        quantity: str,
        statistic: str,
        value: float | None = None,
        pixels: str = OWN,
    ) -> Row:
        """Return one figure.

        Parameters
        ----------
        case, method, quantity, statistic, value, pixels
            What tells it from others; without a value, the first one.

        Raises
        ------
        KeyError
            If there is none.
        """
        for row in self.rows:
            told = (row.case, row.method, row.quantity, row.statistic, row.pixels)
            if told == (case, method, quantity, statistic, pixels) and (
                value is None or math.isclose(row.value, value)
            ):
                return row
        msg = f"there is no {statistic} of {quantity} by {method} in case {case} at {value}, on {pixels} pixels"
        raise KeyError(msg)

    def summary(self) -> pd.DataFrame:
        """Return what stands for each case, in the median over its values: a row per case, a column per method.

        Where several methods tell the quantity, figures are those of the pixels that all of them tell.
        """
        import pandas as pd

        found: dict[str, dict[str, float]] = {}
        for case in self.cases:
            quantity, statistic = case.headline
            for label in [*self.methods, BOUND]:
                figures = self._headline(case.kind, label, quantity, statistic)
                if figures:
                    found.setdefault(f"{case.title}: {quantity} {statistic}", {})[label] = float(
                        pd.Series(figures).median()
                    )
        return pd.DataFrame.from_dict(found, orient="index", columns=None).reindex(
            columns=[*self.methods, *([BOUND] if any(BOUND in one for one in found.values()) else [])]
        )

    def efficiency(self) -> pd.DataFrame:
        """Return noise beside the Cramér-Rao bound: columns case, value, method, quantity, noise, bound, efficiency.

        Efficiency is (bound / noise)², in %: the share of the images' information that a method uses. Above 100 %, its
        window is larger than that of the bound, or it is biased.
        """
        import pandas as pd

        bounds = {(row.case, row.value, row.quantity): row.number for row in self.rows if row.method == BOUND}
        cells = [
            (row.case, row.value, row.method, row.quantity, row.number, bound, 100 * (bound / row.number) ** 2)
            for row in self.rows
            if row.statistic == "noise"
            and row.method != BOUND
            and row.number > 0
            and (bound := bounds.get((row.case, row.value, row.quantity), math.nan)) == bound
        ]
        columns = ["case", "value", "method", "quantity", "noise", "bound", "efficiency_percent"]
        return pd.DataFrame(cells, columns=columns)

    def _headline(self, case: str, label: str, quantity: str, statistic: str) -> list[float]:
        rows: Mapping[str, list[float]] = {OWN: [], COMMON: []}
        for row in self.rows:
            if (row.case, row.method, row.quantity, row.statistic) == (case, label, quantity, statistic):
                rows.get(row.pixels, []).append(abs(row.number))
        return rows[COMMON] or rows[OWN]

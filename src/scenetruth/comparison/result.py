"""What a comparison has found: a tidy table of all figures, and a summary with a row for each method and case."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.comparison.case import Case
from scenetruth.comparison.rows import BOUND, OWN, Row
from scenetruth.comparison.standing import Standing, Standings

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
    own
        Labels of the methods whose algorithms are scenetruth's own.
    slips
        Likely slips of convention in what all other methods gave, as of `scenetruth.scoring.find_slips`: lines to read.

    See Also
    --------
    scenetruth.compare : Measures the methods, and returns one.

    Examples
    --------
    Two guesses at a wall, which stands 720 mm away:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> def near(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 500.0)}
    >>> def far(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 800.0)}
    >>> found = st.compare([near, far], cases=["disparity"], values=[1.3])
    >>> found
    Comparison(methods=['near', 'far'], folder=None, own=[])
    >>> found.summary().round(2).to_dict("index")
    {'Range of disparity: disparity rms': {'near': 0.57, 'far': 0.13}}
    >>> row = found.figure("disparity", "far", "depth", "bias")
    >>> round(row.number, 1), row.unit
    (80.0, 'mm')
    >>> frame = found.to_frame()
    >>> frame[(frame.method == "near") & (frame.quantity == "depth") & (frame.statistic == "density")].number.tolist()
    [1.0]
    """

    methods: Sequence[str]
    cases: Sequence[Case] = field(repr=False)
    rows: Sequence[Row] = field(repr=False)
    failures: Sequence[str] = field(default=(), repr=False)
    folder: Path | None = None
    own: Sequence[str] = ()
    slips: Sequence[str] = field(default=(), repr=False)

    def to_frame(self) -> pd.DataFrame:
        """Return all figures, a row each.

        Columns are the fields of `scenetruth.comparison.rows.Row`, and after ``value`` its ``label``: what the value is
        called, as the name of a scene; empty for figures of all values.
        """
        import pandas as pd

        frame = pd.DataFrame([asdict(row) for row in self.rows], columns=list(Row.__dataclass_fields__))
        cases = {case.kind: case for case in self.cases}
        labels = [cases[row.case].label_of(row.value) if math.isfinite(row.value) else "" for row in self.rows]
        frame.insert(frame.columns.get_loc("value") + 1, "label", pd.Series(labels, dtype=object))
        return frame

    def figure(
        self,
        case: str,
        method: str,
        quantity: str,
        statistic: str,
        value: float | str | None = None,
        pixels: str = OWN,
    ) -> Row:
        """Return one figure.

        Parameters
        ----------
        case, method, quantity, statistic, value, pixels
            What tells it from others; without a value, or what that is called, the first one.

        Raises
        ------
        KeyError
            If there is none.
        """
        if isinstance(value, str):
            value = next((one.value_of(value) for one in self.cases if one.kind == case), math.nan)
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
        for one in self.headlines():
            found[f"{one.case.title}: {one.quantity} {one.statistic.replace('_', ' ')}"] = dict(one.numbers)
        return pd.DataFrame.from_dict(found, orient="index", columns=None).reindex(
            columns=[*self.methods, *([BOUND] if any(BOUND in one for one in found.values()) else [])]
        )

    def headlines(self) -> list[Standing]:
        """Return what stands for each case, in the median over its values; cases that nobody tells are left out."""
        standings = Standings(self.rows, self.methods)
        found = (standings.standing(case, *case.headline) for case in self.cases)
        return [one for one in found if one is not None]

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

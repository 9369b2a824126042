"""The result of a benchmark and the ranking of methods."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.benchmark.cases.case import BOUND, COMMON_VALID, METHOD_VALID, BenchmarkRecord, Case, all_cases
from scenetruth.errors import ArgumentError, Problem
from scenetruth.results import QuantityValue, Result

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["BenchmarkResult", "RankedMethod", "Ranking"]


@dataclass(frozen=True)
class RankedMethod:
    """Values of one statistic for several methods; lower is better (errors, or a cut-off period).

    ``label``: The level, or empty for the median over all levels. ``numbers``: Values by method, and of the bound.
    """

    case: Case
    quantity: str
    statistic: str
    label: str
    unit: str
    numbers: Mapping[str, float]

    @property
    def of_methods(self) -> dict[str, float]:
        """The values of the methods with a result, the best first."""
        entries = {label: one for label, one in self.numbers.items() if label != BOUND and not math.isnan(one)}
        return dict(sorted(entries.items(), key=lambda pair: pair[1]))


class Ranking:
    """Records of a benchmark grouped by case, quantity and statistic."""

    def __init__(self, rows: Sequence[BenchmarkRecord], methods: Sequence[str]) -> None:
        self._methods = [*methods, BOUND]
        self._rows: dict[tuple[str, str, str], list[BenchmarkRecord]] = {}
        for row in rows:
            self._rows.setdefault((row.case, row.quantity, row.statistic), []).append(row)

    def standing(self, case: Case, quantity: str, statistic: str, value: float | None = None) -> RankedMethod | None:
        """Return the values of the methods; None if no method has a result."""
        rows = self._rows.get((case.kind, quantity, statistic), ())
        rows = [row for row in rows if value is None or row.level == value]
        numbers = {}
        for label in self._methods:
            mine = [row for row in rows if row.method == label]
            figures = [abs(row.value) for row in mine if row.pixels == COMMON_VALID] or [
                abs(row.value) for row in mine if row.pixels == METHOD_VALID
            ]
            if figures:
                # Undefined values are excluded from the median.
                there = [one for one in figures if not math.isnan(one)]
                numbers[label] = statistics.median(there) if there else math.nan
        label = "" if value is None else case.get_label(value)
        return RankedMethod(case, quantity, statistic, label, rows[0].unit, numbers) if numbers else None


@dataclass(frozen=True)
class BenchmarkResult(Result):
    """Results of methods on the cases of a suite.

    Parameters
    ----------
    methods
        Labels of the methods, in the order of the call.
    cases
        The cases.
    rows
        All records.
    failures
        Reasons for missing results, one line each with case, level and label.
    folder
        Output directory, or None.
    own
        Labels of the built-in methods.
    convention_mismatches
        Likely convention mismatches of all other methods, one line each; see
        `scenetruth.scoring.detect_convention_mismatches`.

    See Also
    --------
    scenetruth.compare : Run methods on the benchmark suite.

    Examples
    --------
    Two constant depth maps of a wall at a distance of 720 mm:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> def near(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 500.0)}
    >>> def far(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 800.0)}
    >>> found = st.compare([near, far], cases=["disparity"], levels=[1.3])
    >>> found
    BenchmarkResult(methods=['near', 'far'], folder=None, own=[])
    >>> found.ranking().round(2).to_dict("index")
    {'Range of disparity: disparity rmse': {'near': 0.57, 'far': 0.13}}
    >>> row = found.value("depth", "bias", case="disparity", method="far")
    >>> round(row.value, 1), row.unit
    (80.0, 'mm')
    >>> frame = found.to_dataframe()
    >>> frame[(frame.method == "near") & (frame.quantity == "depth") & (frame.statistic == "density")].value.tolist()
    [1.0]
    """

    methods: Sequence[str]
    cases: Sequence[Case] = field(repr=False)
    rows: Sequence[BenchmarkRecord] = field(repr=False)
    failures: Sequence[str] = field(default=(), repr=False)
    folder: Path | None = None
    own: Sequence[str] = ()
    convention_mismatches: Sequence[str] = field(default=(), repr=False)

    def to_dataframe(self) -> pd.DataFrame:
        """Return all records as a table.

        The columns are the fields of `scenetruth.benchmark.cases.case.BenchmarkRecord` and, after ``level``, its
        ``label``, for example the name of a scene; empty for records of all levels.
        """
        import pandas as pd

        frame = pd.DataFrame([asdict(row) for row in self.rows], columns=list(BenchmarkRecord.__dataclass_fields__))
        cases = {case.kind: case for case in self.cases}
        labels = [cases[row.case].get_label(row.level) if math.isfinite(row.level) else "" for row in self.rows]
        frame.insert(frame.columns.get_loc("level") + 1, "label", pd.Series(labels, dtype=object))
        return frame

    def value(
        self,
        quantity: str,
        statistic: str = "rmse",
        *,
        case: str,
        method: str,
        level: float | str | None = None,
        pixels: str = METHOD_VALID,
    ) -> QuantityValue:
        """Return one statistic of one method in one case.

        Parameters
        ----------
        quantity, statistic, case, method
            As in the table of `to_dataframe`.
        level
            The level, or its label; by default the first.
        pixels
            Set of pixels: ``method_valid``, ``common_valid`` or ``all``.

        Returns
        -------
        QuantityValue
            With the 95 % confidence interval where there is one; ``region`` is the set of pixels.

        Raises
        ------
        ArgumentError
            If there is no such record; the message names what was asked for.
        """
        place = level
        if isinstance(level, str):
            place = next((one.parse_level(level) for one in self.cases if one.kind == case), math.nan)
        for row in self.rows:
            if (row.case, row.method, row.quantity, row.statistic, row.pixels) == (
                *(case, method, quantity, statistic),
                pixels,
            ) and (place is None or math.isclose(row.level, float(place))):
                return QuantityValue(row.value, row.unit, row.ci_low, row.ci_high, statistic=statistic, region=pixels)
        message = f"there is no {statistic} by {method} in case {case} at {level}, on {pixels} pixels"
        raise ArgumentError([Problem("quantity", message, quantity)])

    def summary(self) -> str:
        """Return the methods of every case from the best to the worst, one case per line; then failures."""
        lines = []
        for one in self.headlines():
            values = ", ".join(f"{label} {number:.3g}" for label, number in one.of_methods.items())
            name = f"{one.quantity} {one.statistic.replace('_', ' ')}"
            lines.append(f"{one.case.title}: {name} {values} {one.unit}".rstrip())
        return "\n".join([*lines, *self.convention_mismatches, *self.failures])

    def ranking(self) -> pd.DataFrame:
        """Return the main statistic of each case, the median over its levels: a row per case, a column per method.

        Where several methods have estimates of the quantity, the values are those of the pixels valid in all of them.
        """
        import pandas as pd

        table: dict[str, dict[str, float]] = {}
        for one in self.headlines():
            table[f"{one.case.title}: {one.quantity} {one.statistic.replace('_', ' ')}"] = dict(one.numbers)
        return pd.DataFrame.from_dict(table, orient="index", columns=None).reindex(
            columns=[*self.methods, *([BOUND] if any(BOUND in one for one in table.values()) else [])]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain values; cases by name."""
        return {**super().to_dict(), "cases": [case.kind for case in self.cases]}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> BenchmarkResult:
        """Return the result that `to_dict` converted.

        Raises
        ------
        ValueError, KeyError, TypeError
            If it is of another type or version, or a case is not installed.
        """
        installed = all_cases()
        return replace(super().from_dict({**plain, "cases": []}), cases=[installed[kind] for kind in plain["cases"]])

    def headlines(self) -> list[RankedMethod]:
        """Return the headline of each case, median over its levels, without cases that no method estimates."""
        standings = Ranking(self.rows, self.methods)
        found = (standings.standing(case, *case.headline) for case in self.cases)
        return [one for one in found if one is not None]

    def efficiency(self) -> pd.DataFrame:
        """Return noise, bound and efficiency: case, level, method, quantity, noise_std, bound, efficiency_percent.

        The efficiency is (bound / noise)², in %: the Cramér-Rao variance over the observed variance. It exceeds 100 %
        for a method with a larger window than that of the bound, or with bias.
        """
        import pandas as pd

        bounds = {(row.case, row.level, row.quantity): row.value for row in self.rows if row.method == BOUND}
        cells = [
            (row.case, row.level, row.method, row.quantity, row.value, bound, 100 * (bound / row.value) ** 2)
            for row in self.rows
            if row.statistic == "noise_std"
            and row.method != BOUND
            and row.value > 0
            and (bound := bounds.get((row.case, row.level, row.quantity), math.nan)) == bound
        ]
        columns = ["case", "level", "method", "quantity", "noise_std", "bound", "efficiency_percent"]
        return pd.DataFrame(cells, columns=columns)

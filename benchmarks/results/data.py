"""The data of the page: for each method a table of all its values, and a file that says how they were made."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from scenetruth.benchmark.cases.case import ALL, BOUND, METHOD_VALID, BenchmarkRecord, all_cases
from scenetruth.output import write_atomically

__all__ = ["COLUMNS", "MethodData", "read_methods_data", "spelled", "table_of", "write_csv", "write_method_data"]

_STATISTICS = {
    "rmse": "rmse",
    "median_abs_error": "median_abs_error",
    "bias": "bias",
    "noise_std": "noise_std",
    "amplitude_ratio": "amplitude_ratio",
    "cutoff_period_first": "period_at_10_percent_loss",
    "cutoff_period_last": "last_period_at_10_percent_loss",
    "rms_z": "rms_z",
}
"""Columns of statistics of the valid pixels of the method itself."""
COLUMNS = (
    *("case", "level", "quantity", "unit", "rmse", "rmse_ci_low", "rmse_ci_high", "median_abs_error", "bias"),
    *("noise_std", "bound_std", "valid_percent", "bad_percent", "rms_z", "beyond_3_std_percent", "amplitude_ratio"),
    *("period_at_10_percent_loss", "last_period_at_10_percent_loss"),
)
"""Columns of a table of a method. Without a level: a value of all levels."""
_LEFT = ("velocity_x", "velocity_y")
DIGITS = 4


@dataclass(frozen=True)
class MethodData:
    """A method and its values.

    Parameters
    ----------
    key, title, group, images, how, link
        As in `benchmarks.results.contestants.Contestant`.
    version
        Version of the program.
    date
        Day of the newest result.
    machine
        Processor.
    processor_s
        Processor time in s of all results.
    cost
        Of one estimate of the cube: ``processor_s``, and ``memory_mb``, the peak memory of its process.
    failures
        Why there is no result, or not for each noise realisation, by scene: the job, with the level if it has several.
    missing
        Jobs that were not measured yet.
    table
        Values, with `COLUMNS`.
    """

    key: str
    title: str
    group: str
    images: str
    how: str
    link: str
    version: str
    date: str
    machine: str
    processor_s: float
    cost: Mapping[str, float] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    missing: Sequence[str] = ()
    table: pd.DataFrame = field(default_factory=pd.DataFrame, compare=False)

    def rows(self, case: str, quantity: str) -> pd.DataFrame:
        """Return the rows of a quantity of a case."""
        return self._groups.get((case, quantity), self.table.iloc[:0])

    def columns(
        self, case: str, quantity: str, column: str
    ) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
        """Return the levels of a quantity of a case, a column of numbers, and the valid pixels in %."""
        found = self._arrays.get((case, quantity, column))
        if found is None:
            rows = self.rows(case, quantity)
            numbers, shares = (rows[name].to_numpy(float, na_value=math.nan) for name in (column, "valid_percent"))
            found = rows["level"].to_numpy(object), numbers, shares
            self._arrays[case, quantity, column] = found
        return found

    @cached_property
    def _arrays(
        self,
    ) -> dict[tuple[str, str, str], tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]]:
        return {}

    @cached_property
    def _groups(self) -> dict[tuple[str, str], pd.DataFrame]:
        return dict(list(self.table.groupby(["case", "quantity"], sort=False)))


def table_of(rows: Iterable[BenchmarkRecord]) -> pd.DataFrame:
    """Return the records of a method, one line for each case, level and quantity.

    Parameters
    ----------
    rows
        Records of the method, and of the bound.
    """
    lines: dict[tuple[str, str, str], dict[str, Any]] = {}
    for row in rows:
        if not row.quantity or row.quantity in _LEFT:
            continue
        level = all_cases()[row.case].get_label(row.level) if math.isfinite(row.level) else ""
        found = lines.setdefault((row.case, level, row.quantity), {})
        if row.method == BOUND:
            found["bound_std"] = row.value
        elif row.pixels == METHOD_VALID and row.statistic in _STATISTICS:
            found[_STATISTICS[row.statistic]] = row.value
            if row.unit != "1":
                found["unit"] = row.unit
            if row.statistic == "rmse":
                found["rmse_ci_low"], found["rmse_ci_high"] = row.ci_low, row.ci_high
        elif row.statistic == "density":
            found["valid_percent"] = 100 * row.value
        elif row.statistic == "inlier_rate" and row.pixels == ALL:
            found["bad_percent"] = 100 * (1 - row.value)
        elif row.statistic == "coverage" and row.threshold == 3:
            found["beyond_3_std_percent"] = 100 * (1 - row.value)
    plain = [dict(zip(COLUMNS[:3], key, strict=True)) | values for key, values in lines.items()]
    return pd.DataFrame(plain, columns=list(COLUMNS))


def write_method_data(folder: Path, data: MethodData) -> None:
    """Write a method: KEY.csv and KEY.json.

    Parameters
    ----------
    folder
        Folder of all methods.
    data
        The method.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / f"{data.key}.csv", data.table)
    plain = {name: value for name, value in asdict(data).items() if name != "table"}
    with write_atomically(folder / f"{data.key}.json", overwrite=True) as partial:
        partial.write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def write_csv(file: Path, frame: pd.DataFrame) -> None:
    """Write a table with four significant digits.

    Parameters
    ----------
    file
        The file.
    frame
        The table.
    """
    with write_atomically(file, overwrite=True) as partial:
        frame.to_csv(partial, index=False, float_format=f"%.{DIGITS}g", lineterminator="\n")


def read_methods_data(folder: Path) -> list[MethodData]:
    """Return the methods of a folder, in the order of the page.

    Parameters
    ----------
    folder
        Folder of all methods.
    """
    from benchmarks.results.contestants import CONTESTANTS

    order = [one.key for one in CONTESTANTS]
    found = []
    for file in sorted(folder.glob("*.json")):
        plain = json.loads(file.read_text(encoding="utf-8"))
        table = pd.read_csv(
            file.with_suffix(".csv"),
            dtype={"level": str, "unit": str},
            keep_default_na=False,
            na_values={name: [""] for name in COLUMNS[4:]},
        )
        found.append(MethodData(**plain | {"missing": tuple(plain["missing"])}, table=table))
    return sorted(found, key=lambda one: (order.index(one.key) if one.key in order else len(order), one.key))


def spelled(value: float | None, digits: int = 2) -> str:
    """Spell a number with significant digits; a dash if there is none.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    rounded = float(f"{value:.{digits - 1}e}")
    if rounded and abs(rounded) < 1e-3:
        mantissa, _, exponent = f"{rounded:.{digits - 1}e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{rounded:g}" if abs(rounded) >= 1e5 else f"{rounded:.{max(0, digits - 1 - _magnitude(rounded))}f}"


def _magnitude(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0


def select(frame: pd.DataFrame, **wanted: Any) -> pd.DataFrame:
    """Return the rows of a table with these values.

    Parameters
    ----------
    frame
        The table.
    wanted
        Value by column.
    """
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    return frame


def markdown(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown.

    Parameters
    ----------
    columns
        Headings.
    lines
        Cells.
    """
    rows = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return "\n".join([*rows, *(f"| {' | '.join(one)} |" for one in lines)])

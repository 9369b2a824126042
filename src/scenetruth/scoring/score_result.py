"""The score of an estimate: its statistics, and their output as JSON, table, CSV, HTML and one line of text."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from scenetruth.errors import Problem, ScoreError, StoreError
from scenetruth.input_files import regular_file_size
from scenetruth.number_format import format_count, format_number, format_percent_value
from scenetruth.plain_data import parse_json, plain_problems
from scenetruth.results import QuantityValue, Result, refuse_unknown
from scenetruth.scoring.common_statistics import COMMON_STATISTICS
from scenetruth.scoring.quantities import ENDPOINT, OUTLIERS, QUANTITIES, QUANTITY_GROUPS, get_title, get_units
from scenetruth.scoring.regions import REGIONS, is_further_region
from scenetruth.scoring.statistics import RATES, STATISTICS
from scenetruth.settings import ScoreSettings

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "GrowingObjects",
    "Score",
    "find_growing_objects",
    "includes_fallback",
    "is_growth",
    "select_summary_quantities",
]


Values = Mapping[str, float | int | None]
Regions = Mapping[str, Mapping[str, Values]]

_MAIN = (("depth", "disparity"), (ENDPOINT, "flow_x"), ("growth_rate_windowed",))
"""Main quantities; the summary line has the first of each group that the score contains."""

_SUMMARY_COLUMNS: Mapping[str, tuple[str, Callable[[float | None], str]]] = {
    "bias": ("bias", format_number),
    "rmse": ("RMSE", format_number),
    "median_abs_error": ("median |e|", format_number),
    "p95_abs_error": ("95 % |e|", format_number),
    "relative_rmse": ("relative RMSE [%]", format_percent_value),
    "density": ("density [%]", format_percent_value),
    "count": ("pixels", format_count),
}


def includes_fallback(score: Score) -> bool:
    """Return whether fallback values count as valid in a score."""
    settings = score.metadata.get("score_settings") or {}
    return bool(settings.get("include_fallback", False))


def select_summary_quantities(regions: Regions, *, grows: bool) -> list[str]:
    """Return the quantities with errors in a score; growth only where a true growth rate is nonzero."""
    return [name for name in regions["all"] if name != OUTLIERS and (grows or not QUANTITIES[name].is_growth)]


_ROUNDING = 1e9
"""Relative RMSE of growth beyond which the true growth rate consists of rounding errors."""


def is_growth(relative_rmse: float | None) -> bool:
    """Return whether the true growth rate exceeds rounding errors, by the RMSE relative to it."""
    return relative_rmse is not None and relative_rmse < _ROUNDING


_OBJECT = "object_"


@dataclass(frozen=True)
class GrowingObjects:
    """The objects that grow, in a score with others that do not: errors over all pixels are mainly those of the others.

    ``regions``: Names of their regions, which are in the interior.
    """

    regions: tuple[str, ...]

    @property
    def names(self) -> str:
        """The names of the objects as text."""
        found = [f"“{region.removeprefix(_OBJECT)}”" for region in self.regions]
        return found[0] if len(found) == 1 else f"{len(found)} objects"

    def values(self, regions: Regions, quantity: str) -> dict[str, float | int | None]:
        """Return the RMSE, relative RMSE, density and count of a quantity over all of them, as of one region.

        The median is that of a single object.
        """
        parts = [values for region in self.regions if (values := regions[region][quantity])["count"]]
        count = sum(int(values["count"] or 0) for values in parts)
        squares, of_truth, pixels = 0.0, 0.0, 0.0
        for values in parts:
            number, rms, relative = (float(values[name] or 0.0) for name in ("count", "rmse", "relative_rmse"))
            squares += number * rms**2
            of_truth += number * (rms / relative) ** 2 if relative else 0.0
            pixels += number / float(values.get("density") or 1.0)
        return {
            "rmse": math.sqrt(squares / count) if count else None,
            "median_abs_error": parts[0].get("median_abs_error") if len(parts) == 1 else None,
            "relative_rmse": math.sqrt(squares / of_truth) if of_truth else None,
            "density": count / pixels if pixels else None,
            "count": count,
        }


def find_growing_objects(regions: Regions) -> GrowingObjects | None:
    """Return the objects that grow, if others do not and one of them is a region of its own; otherwise None."""
    growing: list[str] = []
    still: list[str] = []
    for region, quantities in regions.items():
        name = next((name for name in ("growth_rate", "growth_rate_windowed") if name in quantities), None)
        if not region.startswith(_OBJECT) or name is None or not quantities[name]["count"]:
            continue
        (growing if is_growth(quantities[name].get("relative_rmse")) else still).append(region)
    return GrowingObjects(tuple(growing)) if growing and still else None


def line_summary(regions: Regions, *, grows: bool) -> str:
    """Return a one-line summary: regions, quantities and main errors of a score."""
    shown = select_summary_quantities(regions, grows=grows)
    groups = [name for name, members in QUANTITY_GROUPS.items() if set(members) & set(shown)]
    interior = regions["interior"]
    main = [next((name for name in names if name in shown), None) for names in _MAIN]
    errors = [f"{name} {_short(interior[name]['rmse'])} {get_units(name)}" for name in main if name is not None]
    parts = {
        "regions": ", ".join(REGIONS) + (f" and {len(regions) - 2} more" if len(regions) > 2 else ""),
        "quantities": ", ".join(groups),
        "RMSE in the interior": ", ".join(errors),
    }
    return f"Score({'; '.join(f'{name}: {text}' for name, text in parts.items())})"


def html_summary(regions: Regions, *, grows: bool) -> str:
    """Return an HTML table of the errors in the regions of every score."""
    names = select_summary_quantities(regions, grows=grows)
    heads = _row("th", ["region", "quantity", "unit", *(heading for heading, _ in _SUMMARY_COLUMNS.values())])
    rows = [
        _row("td", [region, get_title(name), get_units(name), *_cells(regions[region][name])])
        for region in REGIONS
        for name in names
    ]
    further = [region for region in regions if region not in REGIONS]
    more = f"<p>Further regions: {escape(', '.join(further))}</p>" if further else ""
    caption = "<caption>Errors e = estimate − truth</caption>"
    return f"<table>{caption}<thead>{heads}</thead><tbody>{''.join(rows)}</tbody></table>{more}"


def _cells(values: Values) -> list[str]:
    return [spell(values[name]) for name, (_, spell) in _SUMMARY_COLUMNS.items()]


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _short(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3g}"


_COLUMNS = (*STATISTICS[:-1], *COMMON_STATISTICS, *RATES)
_IN_UNITS = ("bias", "rmse", "median_abs_error", "p95_abs_error")
"""Statistics in the unit of the quantity; the others are ratios."""


@dataclass(frozen=True, repr=False)
class Score(Result):
    """The error statistics of one estimate.

    Parameters
    ----------
    regions
        Mapping of region to quantity to statistic to value; None where a value is undefined. Errors are estimate minus
        truth, in the units of the quantity; ``density``, ``relative_rmse``, ``coverage_2_std`` and outlier rates are
        fractions, and ``rms_z``, ``bias_z`` and ``rms_z_pixel`` are ratios. ``all`` and
        ``interior`` come first; further regions depend on the truth.
        All regions have the same quantities, those of the estimate.
    metadata
        Origin of the score, as plain JSON values.

    See Also
    --------
    score : Compute a score.
    write_report : Write a report with figures.

    Examples
    --------
    >>> found = Score(
    ...     {
    ...         "all": {"depth": {"bias": 0.01, "rmse": 0.02, "density": 0.9, "count": 900}},
    ...         "interior": {"depth": {"bias": 0.0, "rmse": 0.01, "density": 1.0, "count": 600}},
    ...     },
    ...     {"seed": 1},
    ... )
    >>> found
    Score(regions: all, interior; quantities: depth; RMSE in the interior: depth 0.01 mm)
    >>> found.regions["interior"]["depth"]["rmse"], found.metadata
    (0.01, {'seed': 1})
    >>> print(found.to_dataframe().loc[("all", "depth"), "units"], found.to_dataframe().loc[("all", "depth"), "rmse"])
    mm 0.02
    """

    regions: Mapping[str, Mapping[str, Mapping[str, float | int | None]]]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def grows(self) -> bool:
        """Whether any true growth rate exceeds rounding errors; growth is omitted for rigid motion."""
        return is_growth(self.regions["all"].get("growth_rate", {}).get("relative_rmse"))

    def __repr__(self) -> str:
        return line_summary(self.regions, grows=self.grows)

    def _repr_html_(self) -> str:
        """Return the main table for notebooks."""
        return html_summary(self.regions, grows=self.grows)

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "interior") -> QuantityValue:
        """Return a statistic of the errors of a quantity.

        Parameters
        ----------
        quantity
            A key of `scenetruth.scoring.QUANTITIES` that the estimate has.
        statistic
            The statistic, for example ``rmse``, ``bias``, ``median_abs_error`` or ``density``.
        region
            A region of the score.

        Returns
        -------
        QuantityValue
            With the number of pixels as ``n``, and without an interval; NaN if undefined.

        Raises
        ------
        ArgumentError
            If the score lacks one of them; the message lists those that it has.
        """
        refuse_unknown(region=(region, self.regions), quantity=(quantity, self.regions["all"]))
        values = self.regions[region][quantity]
        refuse_unknown(statistic=(statistic, values))
        number, count = values[statistic], values.get("count")
        unit = get_units(quantity) if statistic in _IN_UNITS else "1"
        size = None if count is None else int(count)
        return QuantityValue(
            math.nan if number is None else float(number), unit, statistic=statistic, region=region, n=size
        )

    def summary(self) -> str:
        """Return one line with the regions, the quantities and the main errors."""
        return line_summary(self.regions, grows=self.grows)

    def to_dict(self) -> dict[str, Any]:
        """Return the regions and ``metadata`` as plain values; undefined values are None."""
        return {**self.regions, "metadata": self.metadata}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Score:
        """Return the score that `to_dict` converted.

        Raises
        ------
        ScoreError
            As `from_json`.
        """
        problems = plain_problems(plain) or [*_problems(plain)]
        if problems:
            raise ScoreError(problems)
        regions = {name: values for name, values in plain.items() if name != "metadata"}
        return cls(regions={name: regions[name] for name in (*REGIONS, *regions)}, metadata=plain["metadata"])

    def to_json(self) -> str:
        """Return strict JSON with the regions and ``metadata`` as its top-level keys."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)

    @classmethod
    def load(cls, path: str | Path) -> Score:
        """Load a score that `save` wrote, or a ``score.json`` of a run.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        StoreError
            If the file cannot be read or does not hold a score.
        """
        file = Path(path)
        try:
            regular_file_size(file)
            return cls.from_json(file.read_bytes())
        except ValueError as error:
            raise StoreError(file, f"{error}; create it with `scenetruth score`") from error
        except OSError as error:
            raise StoreError(file, f"cannot be read ({error.strerror}); create it with `scenetruth score`") from error
        except ScoreError as error:
            raise StoreError(
                file, f"is damaged or not a score; create it again with `scenetruth score`: {error}"
            ) from error

    @classmethod
    def from_json(cls, text: str | bytes) -> Score:
        """Read a score from the output of `to_json`.

        Raises
        ------
        ScoreError
            If the text is not JSON, lacks ``all``, ``interior``, a statistic, or a quantity of another region, or has
            values that are not finite or unknown region names; lists every problem.
        """
        try:
            content = parse_json(text)
        except (ValueError, TypeError) as error:
            raise ScoreError([Problem("", f"is not JSON: {error}", text)]) from error
        if not isinstance(content, dict):
            raise ScoreError([Problem("", "must be a JSON object", content)])
        return cls.from_dict(content)

    def to_dataframe(self) -> pd.DataFrame:
        """Return the score as a table.

        Returns
        -------
        pandas.DataFrame
            One row for each region and quantity (its two index levels), a column ``units``, and one column for each
            statistic; NaN where a statistic is undefined or does not apply to the quantity.
        """
        import pandas as pd

        # Most estimates state no common part.
        common = {name for quantities in self.regions.values() for values in quantities.values() for name in values}
        columns = [name for name in _COLUMNS if name in common or name not in COMMON_STATISTICS]
        rows = {
            (region, quantity): {"units": get_units(quantity)}
            | {column: math.nan if values.get(column) is None else values[column] for column in columns}
            for region, quantities in self.regions.items()
            for quantity, values in quantities.items()
        }
        index = pd.MultiIndex.from_tuples(list(rows), names=["region", "quantity"])
        return pd.DataFrame(list(rows.values()), index=index, columns=["units", *columns])

    def to_csv(self) -> str:
        """Return the table of `to_dataframe` as comma-separated values with a header; undefined values are empty."""
        return str(self.to_dataframe().to_csv(lineterminator="\n"))


def _problems(content: Mapping[str, Any]) -> Iterator[Problem]:
    """Report the problems of parsed JSON as a score."""
    keys = (*REGIONS, "metadata")
    for key in dict.fromkeys((*keys, *content)):
        if key not in keys and not is_further_region(key):
            yield Problem(key, f"is neither one of the keys {keys} nor a region")
        elif not isinstance(content.get(key), dict):
            yield Problem(key, "must be a JSON object", content.get(key))
    regions = {key: value for key, value in content.items() if key != "metadata" and isinstance(value, dict)}
    expected = _expected(regions)
    if not expected:
        yield Problem("all", f"must have at least one of {', '.join(QUANTITY_GROUPS)}", sorted(regions.get("all", {})))
    for region, quantities in regions.items():
        if region not in keys and not is_further_region(region):
            continue
        for quantity, statistics in expected.items():
            values = quantities.get(quantity)
            for statistic in statistics:
                if not isinstance(values, dict) or statistic not in values:
                    yield Problem(f"{region}.{quantity}.{statistic}", "is missing")
        for quantity, values in quantities.items():
            if quantity not in expected:
                yield Problem(f"{region}.{quantity}", f"is not a quantity of the score; use {', '.join(expected)}")
            elif isinstance(values, dict):
                yield from _value_problems(f"{region}.{quantity}", values)
    if isinstance(content.get("metadata"), dict):
        yield from _metadata_problems(content["metadata"])


def _value_problems(path: str, values: Mapping[str, Any]) -> Iterator[Problem]:
    for statistic, value in values.items():
        if statistic == "count":
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                yield Problem(f"{path}.count", "must be a non-negative integer", value)
        elif value is not None and not _is_number(value):
            yield Problem(f"{path}.{statistic}", "must be a finite number or null", value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _metadata_problems(metadata: Mapping[str, Any]) -> Iterator[Problem]:
    """Report invalid values of the metadata."""
    if not _is_number(metadata.get("margin_px", 0)):
        yield Problem("metadata.margin_px", "must be a finite number", metadata["margin_px"])
    settings = metadata.get("score_settings")
    if settings is not None:
        try:
            ScoreSettings.model_validate(settings)
        except ValidationError as error:
            yield Problem("metadata.score_settings", f"invalid: {error.errors(include_url=False)[0]['msg']}", settings)
    warnings = metadata.get("warnings")
    if warnings is not None and not isinstance(warnings, str | list):
        yield Problem("metadata.warnings", "must be a list of texts", warnings)


def _expected(regions: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[str, ...]]:
    """Return the statistics by quantity that every region must have."""
    there = {name for quantities in regions.values() for name in quantities}
    names = [name for group in QUANTITY_GROUPS.values() if there & set(group) for name in group]
    expected: dict[str, tuple[str, ...]] = dict.fromkeys(names, STATISTICS)
    if OUTLIERS in there:
        entries = [quantities.get(OUTLIERS) for quantities in regions.values()]
        rates = {rate for values in entries if isinstance(values, dict) for rate in values}
        expected[OUTLIERS] = tuple(rate for rate in RATES if rate in rates or rate == "count")
    return expected

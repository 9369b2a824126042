"""Comparisons of methods: the main value of each case, and where another program is more accurate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.results.contestants import BUILT_IN
from benchmarks.results.data import MethodData, select
from scenetruth.benchmark.cases.case import all_cases
from scenetruth.scoring.quantities import get_units

__all__ = ["SAME_IMAGES", "Value", "losses", "relative_values", "too_small_bars", "value_of", "values"]

SAME_IMAGES = "refined_4"
"""The built-in method that other programs are compared with: it uses the four images of the stereo programs."""
ALL_IMAGES = "refined"
LEAST_SHARE = 0.5
"""Valid pixels of a program, relative to those of the built-in method, that a comparison requires."""
LEAST_PERCENT = 10.0
"""Valid pixels of a program, in percent, that it requires where the built-in method has no result."""
LEAST_ERROR = 1e-9
"""Smaller errors, in the unit of the quantity, are those of rounded results that coincide with a constant truth."""
GALLERY = "gallery"
GALLERY_QUANTITIES = ("disparity", "velocity_z", "flow_x", "growth_rate_windowed")
_COLUMNS = {"cutoff_period_first": "period_at_10_percent_loss"}
STATISTICS = {
    "rmse": "RMSE",
    "bias": "bias",
    "noise_std": "noise",
    "period_at_10_percent_loss": "period at 10 % loss",
    "bad_percent": "bad pixels",
}
"""Names of the columns of the data."""
_MOST_BEYOND_PERCENT = 1.0
"""Fraction of errors beyond three stated standard deviations from which an error bar is too small; 0.27 % is ideal."""


@dataclass(frozen=True)
class Value:
    """What is compared: a case, or a scene of the gallery, and a quantity with its statistic."""

    case: str
    scene: str
    quantity: str
    column: str
    unit: str

    @property
    def job(self) -> str:
        """Name of its job."""
        return f"{self.case}/{self.scene}" if self.scene else self.case

    @property
    def title(self) -> str:
        """Name of the case, or of the scene."""
        return self.scene or all_cases()[self.case].title


def values(methods: Sequence[MethodData]) -> list[Value]:
    """Return all that is compared: the main statistic of each case, and four quantities of each scene.

    Parameters
    ----------
    methods
        The methods.
    """
    frame = pd.concat([one.table for one in methods])
    found = []
    for kind, case in all_cases().items():
        here = frame[frame["case"] == kind]
        if here.empty:
            continue
        if kind == GALLERY:
            for scene in dict.fromkeys(here["level"]):
                there = set(select(here, level=scene)["quantity"])
                found += [
                    Value(kind, scene, name, "rmse", get_units(name)) for name in GALLERY_QUANTITIES if name in there
                ]
            continue
        quantity, statistic = case.headline
        column = _COLUMNS.get(statistic, statistic)
        unit = "px" if column == "period_at_10_percent_loss" else get_units(quantity)
        found.append(Value(kind, "", quantity, column, unit))
        if quantity in ("disparity", "flow_x", "flow_y") and column == "rmse":
            found.append(Value(kind, "", quantity, "bad_percent", "%"))
    return found


def value_of(one: MethodData, value: Value, levels: Sequence[str] | None = None) -> tuple[float, float]:
    """Return the median over levels, and the valid pixels in %; NaN if there is no result.

    Parameters
    ----------
    one
        The method.
    value
        The value.
    levels
        Levels; all if not given.
    """
    there, numbers, shares = _columns_of(one, value)
    if levels is not None:
        kept = np.isin(there, levels)
        numbers, shares = numbers[kept], shares[kept]
    numbers, shares = np.abs(numbers[~np.isnan(numbers)]), shares[~np.isnan(shares)]
    if not numbers.size:
        return math.nan, math.nan
    if shares.size:
        return float(np.median(numbers)), float(np.median(shares))
    # The median of missing values only is missing; pandas with NumPy 2.0 would warn.
    stated = one.rows(value.case, value.quantity)["valid_percent"].dropna()
    return float(np.median(numbers)), float(stated.median())


def losses(methods: Sequence[MethodData]) -> pd.DataFrame:
    """Return every value in which another program is more accurate than the built-in method with the same images.

    Both are compared over the levels at which the program has a result. ``counts`` says whether the program has at
    least half as many valid pixels as the built-in method, or 10 % of all where that has no result, and errors that
    are not exactly zero, as those of steps of 1/16 px on a plane whose disparity is such a step.

    Parameters
    ----------
    methods
        The methods.
    """
    by_key = {one.key: one for one in methods}
    own, whole = by_key.get(SAME_IMAGES), by_key.get(ALL_IMAGES)
    lines = []
    for value in values(methods):
        for other in methods:
            if other.group == BUILT_IN or own is None or value.job in own.missing:
                continue
            there, numbers, _ = _columns_of(other, value)
            levels = list(there[~np.isnan(numbers)])
            if not levels:
                continue
            number, share = value_of(other, value, levels)
            best, density = value_of(own, value, levels)
            if number >= best:
                continue
            all_images = value_of(whole, value, levels)[0] if whole is not None else math.nan
            least = LEAST_PERCENT if math.isnan(best) else LEAST_SHARE * density
            # A period of zero is the shortest that was tested.
            vanishes = value.column != "period_at_10_percent_loss" and number <= LEAST_ERROR
            lines.append(
                {
                    "case": value.case,
                    "scene": value.scene,
                    "quantity": value.quantity,
                    "statistic": value.column,
                    "unit": value.unit,
                    "program": other.title,
                    "value": number,
                    "valid_percent": share,
                    "refined_4_value": best,
                    "refined_4_valid_percent": density,
                    "refined_all_images_value": all_images,
                    "ratio": number / best if math.isfinite(best) and best else math.nan,
                    "counts": bool(value.column == "bad_percent" or (share >= least and not vanishes)),
                }
            )
    return pd.DataFrame(lines, columns=list(LOSS_COLUMNS))


def relative_values(methods: Sequence[MethodData]) -> pd.DataFrame:
    """Return the values of other programs by those of the built-in method with the same images, by case.

    Parameters
    ----------
    methods
        The methods.
    """
    own = next((one for one in methods if one.key == SAME_IMAGES), None)
    lines = []
    for value in values(methods):
        if value.case == GALLERY or value.column == "bad_percent" or own is None:
            continue
        mine = value_of(own, value)[0]
        for other in methods:
            number, share = value_of(other, value)
            ratio = number / mine if mine else math.nan
            if other.group != BUILT_IN and math.isfinite(ratio) and ratio > 0:
                what = {"case": value.case, "quantity": value.quantity, "statistic": value.column, "unit": value.unit}
                numbers = {"value": number, "valid_percent": share, "refined_4_value": mine, "ratio": ratio}
                lines.append({**what, "program": other.title, **numbers})
    return pd.DataFrame(lines, columns=list(RELATIVE_COLUMNS))


RELATIVE_COLUMNS = (
    *("case", "quantity", "statistic", "unit", "program", "value", "valid_percent", "refined_4_value", "ratio"),
)
LOSS_COLUMNS = (
    *("case", "scene", "quantity", "statistic", "unit", "program", "value", "valid_percent", "refined_4_value"),
    *("refined_4_valid_percent", "refined_all_images_value", "ratio", "counts"),
)


def too_small_bars(methods: Sequence[MethodData]) -> pd.DataFrame:
    """Return the cases in which more than 1 % of the errors are beyond three stated standard deviations.

    Parameters
    ----------
    methods
        The methods.
    """
    lines = []
    for one in methods:
        for (case, quantity), frame in one.table.groupby(["case", "quantity"], sort=False):
            headline = all_cases()[case].headline[0]
            if quantity not in ({headline} if case != GALLERY else {"disparity", "velocity_z"}):
                continue
            for _, row in frame.iterrows():
                if row["beyond_3_std_percent"] > _MOST_BEYOND_PERCENT:
                    lines.append(
                        {
                            "method": one.title,
                            "case": case,
                            "level": row["level"],
                            "quantity": quantity,
                            "rms_z": row["rms_z"],
                            "beyond_3_std_percent": row["beyond_3_std_percent"],
                        }
                    )
    columns = ["method", "case", "level", "quantity", "rms_z", "beyond_3_std_percent"]
    return pd.DataFrame(lines, columns=columns)


def _columns_of(one: MethodData, value: Value) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
    """Return the levels of a value, the value at each, and the valid pixels in %."""
    levels, numbers, shares = one.columns(value.case, value.quantity, value.column)
    kept = levels == value.scene if value.scene else (levels == "") == (value.column == "period_at_10_percent_loss")
    return levels[kept], numbers[kept], shares[kept]

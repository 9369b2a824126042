"""What the suite measures, a row for each figure: tidy, so that any table program can read it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["ALL", "BOUND", "COMMON", "OWN", "Row"]

OWN = "own"
"""Pixels that the method itself tells."""
COMMON = "common"
"""Pixels that all methods of the comparison tell."""
ALL = "all"
"""All pixels of the region; what is missing counts as missing."""
BOUND = "bound"
"""Stands for a method where a row holds the Cramér-Rao bound."""


@dataclass(frozen=True)
class Row:
    """One figure.

    Parameters
    ----------
    case
        Which case of the suite.
    value
        What was varied, in the unit of the case.
    method
        Label of the method, or `BOUND`.
    quantity
        What was measured: a key of `scenetruth.scoring.QUANTITIES`; empty for time and memory.
    pixels
        Over which pixels: `OWN`, `COMMON` or `ALL`.
    statistic
        What of their errors.
    number
        The figure, in the quantity's unit; NaN where there is none.
    low, high
        Its 95 % confidence interval; NaN if it was not found out.
    at
        What a curve is drawn over besides: the share of pixels that is kept, or the number of standard deviations.
    unit
        Unit of the figure.
    """

    case: str
    value: float
    method: str
    quantity: str
    pixels: str
    statistic: str
    number: float
    low: float = math.nan
    high: float = math.nan
    at: float = math.nan
    unit: str = ""

    def to_plain(self) -> dict[str, Any]:
        """Return plain values; None for NaN, which JSON cannot spell."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Row:
        """Return a row from what `to_plain` made."""
        given: dict[str, Any] = {key: math.nan if value is None else value for key, value in plain.items()}
        return cls(**given)

"""What a sweep measures, a row for each figure: tidy, so that any table program can read it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["STATISTICS", "Row"]

STATISTICS = ("rms", "bias", "std", "median", "density")
"""What is told of errors: root of the mean square, mean, standard deviation between seeds, median of the absolute
error; and the share of the pixels that is told."""


@dataclass(frozen=True)
class Row:
    """One figure.

    Parameters
    ----------
    values
        What was varied: values by path.
    scene
        What the scene is called.
    method
        Label of the method; ``bound``, perhaps with the method whose window it has, where it is the Cramér-Rao bound.
    seed
        The scene's seed; None for figures of all seeds.
    region
        Region of the score: ``all``, ``interior``, ``object_NAME``.
    quantity
        What was measured: a key of `scenetruth.scoring.QUANTITIES`.
    statistic
        One of `STATISTICS`.
    number
        The figure.
    low, high
        Its 95 % confidence interval over seeds; NaN if there is none.
    unit
        Its unit.
    """

    values: Mapping[str, Any]
    scene: str
    method: str
    seed: int | None
    region: str
    quantity: str
    statistic: str
    number: float
    low: float = math.nan
    high: float = math.nan
    unit: str = ""

    @property
    def is_bound(self) -> bool:
        """Whether it is no error, but the bound of noise."""
        return self.method.split(" ")[0] == "bound"

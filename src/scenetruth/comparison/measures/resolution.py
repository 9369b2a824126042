"""What is left of waves, as rows: the share at each period, and the periods at which a tenth is lost."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.waves import crossings, share_left, share_of_size
from scenetruth.comparison.rows import OWN, Row
from scenetruth.scoring.reading import Pairs

__all__ = ["FEWEST_TOLD", "crossing_rows", "left_rows"]

FEWEST_TOLD = 0.5
"""If less than this share of the pixels is told, a period counts as not resolved."""


def left_rows(case: Case, found: Found, quantity: str, *, of_mean: bool = False) -> Iterator[Row]:
    """Give the share of a wave that each method leaves; NaN where it tells too little.

    Parameters
    ----------
    case, found
        The case, and what was found.
    quantity
        The quantity that has the wave, a key of `scenetruth.scoring.QUANTITIES`.
    of_mean
        Whether a crest alone is measured, whose mean is its amplitude; else the mean of a wave is left out.
    """
    share = share_of_size if of_mean else share_left
    region = case.region_at(found.truth.isel(t=0), found.value)
    for label, estimate in found.estimates.items():
        pairs, left = Pairs(estimate, found.truth), math.nan
        if quantity not in pairs:
            continue
        pair = pairs[quantity]
        got, true = pair.estimate[0], pair.truth[0]
        told = region & np.isfinite(got) & (True if pair.full is None else pair.full[0])
        if np.count_nonzero(told) >= FEWEST_TOLD * np.count_nonzero(region):
            left = share(got[told], true[told])
        yield Row(case.kind, found.value, label, quantity, OWN, "share_left", left, unit="1")


def crossing_rows(case: Case, rows: Sequence[Row], quantity: str) -> Iterator[Row]:
    """Give the first and the last period, from long to short, at which the share crosses 90 %.

    Parameters
    ----------
    case
        The case.
    rows
        All its rows.
    quantity
        The quantity that has the wave.
    """
    curves: dict[str, dict[float, float]] = {}
    for row in rows:
        if (row.case, row.statistic, row.quantity) == (case.kind, "share_left", quantity):
            curves.setdefault(row.method, {})[row.value] = row.number
    for label, curve in curves.items():
        first, last = crossings(list(curve), list(curve.values()))
        for name, period in (("first", first), ("last", last)):
            yield Row(case.kind, math.nan, label, quantity, OWN, f"period_at_10_percent_loss_{name}", period, unit="px")

"""Errors of growth rates, as rows: over windows, in per cent per hour."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.sizes import sizes_of
from scenetruth.comparison.rows import OWN, Row
from scenetruth.scoring.growth import growth_pairs, knows_growth
from scenetruth.settings import ScoreSettings

__all__ = ["growth_rows"]


def growth_rows(case: Case, found: Found) -> Iterator[Row]:
    """Give sizes of the errors of growth over windows, for methods that give depth and velocity.

    Parameters
    ----------
    case, found
        The case, and what was found.
    """
    region = case.region_at(found.truth.isel(t=0), found.value)
    for label, estimate in found.estimates.items():
        if not knows_growth(estimate, found.truth):
            continue
        for quantity, pair in growth_pairs(estimate, found.truth, ScoreSettings()).items():
            kept = region & np.isfinite(pair.estimate[0]) & np.isfinite(pair.truth[0])
            kept &= True if pair.full is None else pair.full[0]
            errors = np.where(kept, pair.estimate[0] - pair.truth[0], 0.0)
            for statistic, size in sizes_of(errors[None], kept[None]).items():
                yield Row(
                    case.kind,
                    found.value,
                    label,
                    quantity,
                    OWN,
                    statistic,
                    size.number,
                    size.low,
                    size.high,
                    unit="%/h",
                )

"""The metrological efficiency: noise times the period at which a tenth of an amplitude is lost."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from scenetruth.comparison.case import NOISE_STD
from scenetruth.comparison.rows import BOUND, OWN, Row

__all__ = ["product_rows"]

_PAIRS: Mapping[str, str] = {"star": "flow_y", "waves_of_motion": "flow_y", "waves_of_depth": "disparity"}
"""Which noise goes with which resolution; of both, px times px."""
_PERIOD = "period_at_10_percent_loss_"


def product_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """Give the product of noise and period, for both readings of the period.

    Parameters
    ----------
    rows
        All rows of a comparison; noise is that of the sheet at rest with the usual noise. Where it was not measured, or
        a period lies outside of what was, there is no product.
    """
    noise = {
        (row.method, row.quantity): row.number
        for row in rows
        if row.case == "noise" and row.statistic == "noise" and row.method != BOUND and row.value == NOISE_STD
    }
    for row in rows:
        if row.statistic.startswith(_PERIOD) and row.case in _PAIRS:
            quantity = _PAIRS[row.case]
            product = row.number * noise.get((row.method, quantity), math.nan)
            if math.isfinite(product) and product > 0:
                reading = row.statistic.removeprefix(_PERIOD)
                yield Row(
                    row.case, math.nan, row.method, quantity, OWN, f"noise_times_period_{reading}", product, unit="px²"
                )

"""The statistics of all quantities in all regions, gathered part by part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.outliers import Outliers, OutlierTally
from scenetruth.scoring.quantities import OUTLIERS, QUANTITIES
from scenetruth.scoring.reading import Pair
from scenetruth.scoring.statistics import Scored, Statistics, Tally

__all__ = ["Gathering"]

Mask = NDArray[np.bool_]


class Gathering:
    """Gathers the statistics of every quantity in every region.

    Parameters
    ----------
    rates
        The rates of outliers to report: what `meaningful_rates` returns.
    single
        Whether there is one part only; see `Tally`.
    """

    def __init__(self, rates: Sequence[str], *, single: bool) -> None:
        self._rates, self._single = rates, single
        self._tallies: dict[str, dict[str, Tally | Statistics]] = {}
        self._outliers: dict[str, OutlierTally] = {}

    def add(self, pairs: Mapping[str, Pair], regions: Mapping[str, Mask]) -> None:
        """Count a part.

        Parameters
        ----------
        pairs
            The quantities by the keys of `QUANTITIES`; they are looked up once or twice each.
        regions
            Where each region lies, shape (t, y, x).
        """
        for quantity, pair in pairs.items():
            scored = Scored.of(pair, QUANTITIES[quantity].error)
            for name, region in regions.items():
                own = self._tallies.setdefault(name, {})
                tally = own.setdefault(quantity, Tally(single=self._single))
                assert isinstance(tally, Tally)
                tally.add(scored, region)
                if self._single:
                    # Its values need not be kept beside those of all others.
                    own[quantity] = tally.statistics()
        if self._rates:
            outliers = Outliers.of(pairs, self._rates)
            for name, region in regions.items():
                self._outliers.setdefault(name, OutlierTally(self._rates)).add(outliers, region)

    def regions(self) -> dict[str, dict[str, Statistics]]:
        """Return the statistics by region and quantity.

        Quantities are those that were counted, and ``outliers`` if there are rates to report.
        """
        found = {
            region: {name: item.statistics() if isinstance(item, Tally) else item for name, item in tallies.items()}
            for region, tallies in self._tallies.items()
        }
        for region, tally in self._outliers.items():
            found[region][OUTLIERS] = tally.rates()
        return found

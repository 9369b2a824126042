"""The statistics of all quantities in all regions, gathered part by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.outliers import Outliers, OutlierTally
from scenetruth.scoring.quantities import ENDPOINT, OUTLIERS, QUANTITIES, Pair, stacked
from scenetruth.scoring.statistics import Scored, Statistics, Tally

__all__ = ["Gathering"]

Mask = NDArray[np.bool_]

_VELOCITY = ("velocity_x", "velocity_y", "velocity_z")


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
            The quantities, and perhaps further scalar quantities by their names; they are looked up once or twice each.
        regions
            Where each region lies, shape (t, y, x).
        """
        for quantity, scored in _scored(pairs):
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

        Quantities are those of `QUANTITIES`, ``velocity_endpoint`` where there is a velocity, further ones, and
        ``outliers`` if there are rates to report.
        """
        found = {
            region: {name: item.statistics() if isinstance(item, Tally) else item for name, item in tallies.items()}
            for region, tallies in self._tallies.items()
        }
        for region, tally in self._outliers.items():
            found[region][OUTLIERS] = tally.rates()
        return found


def _scored(pairs: Mapping[str, Pair]) -> Iterator[tuple[str, Scored]]:
    """Give what is scored, in the order in which it is reported."""
    for name in pairs:
        if name in QUANTITIES:
            yield name, Scored.of(pairs[name])
    if _VELOCITY[-1] in pairs:
        yield ENDPOINT, Scored.of_vectors(stacked(pairs, _VELOCITY))
    for name in pairs:
        if name not in QUANTITIES:
            yield name, Scored.of(pairs[name])

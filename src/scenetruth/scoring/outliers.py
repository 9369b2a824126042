"""Rates of outliers after the KITTI scene flow benchmark, and whether they say anything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.differences import difference, length
from scenetruth.scoring.reading import Pair, stacked

__all__ = [
    "OUTLIER_FRACTION",
    "OUTLIER_PX",
    "RATES",
    "OutlierTally",
    "Outliers",
    "meaningful_rates",
    "meaningful_rates_of",
    "outlier_rates",
]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATES = ("disparity_rate", "flow_rate", "scene_flow_rate", "count")
"""The statistics of outliers, in the order in which they are reported."""

OUTLIER_PX = 3.0
"""An outlier's error is above this many pixels ..."""

OUTLIER_FRACTION = 0.05
"""... and above this fraction of the true value's magnitude."""

_PARTS: Mapping[str, tuple[str, ...]] = {"disparity_rate": ("disparity",), "flow_rate": ("flow_x", "flow_y")}
"""The quantities that each rate is made of; that of scene flow takes all."""


def outlier_rates(pairs: Mapping[str, Pair], rates: Sequence[str] = RATES[:-1]) -> dict[str, float | int | None]:
    """Return the shares of outliers, as the KITTI scene flow benchmark defines them (Menze and Geiger, CVPR 2015).

    A disparity is an outlier if its error is above 3 px and above 5 % of the true disparity's magnitude. A flow is one
    if its endpoint error is above 3 px and above 5 % of the true flow's length. A pixel is an outlier of scene flow if
    either is. All rates are shares of the same pixels: those where all quantities are scored that the rates need.

    Parameters
    ----------
    pairs
        By name: ``disparity`` in px per step of s, ``flow_x`` and ``flow_y`` in px per frame, any shape. Others are
        not looked at.
    rates
        The rates to return, names of `RATES`.

    Returns
    -------
    dict
        The rates, shares between 0 and 1 or None with no scored pixel, and the ``count`` of scored pixels.

    Examples
    --------
    >>> disparity = Pair(np.array([10.0, 14.0]), np.array([10.0, 10.0]))
    >>> outlier_rates({"disparity": disparity}, ["disparity_rate"])
    {'disparity_rate': 0.5, 'count': 2}
    """
    tally = OutlierTally(rates)
    found = Outliers.of(pairs, rates)
    tally.add(found, np.ones_like(found.scored))
    return tally.rates()


@dataclass(frozen=True)
class Outliers:
    """Which pixels are outliers.

    Parameters
    ----------
    scored
        Where all quantities are scored that the rates need, a map.
    flags
        By rate, whether a pixel is an outlier, at the scored pixels in their order.
    """

    scored: Mask
    flags: Mapping[str, Mask]

    @classmethod
    def of(cls, pairs: Mapping[str, Pair], rates: Sequence[str]) -> Outliers:
        """Find them; parameters as of `outlier_rates`."""
        parts = [part for part in _PARTS if part in rates or "scene_flow_rate" in rates]
        vectors = {part: stacked(pairs, _PARTS[part]) for part in parts}
        scored = np.logical_and.reduce([_scored(vector) for vector in vectors.values()])
        found = {
            part: _is_outlier(vector.estimate[:, scored], vector.truth[:, scored]) for part, vector in vectors.items()
        }
        found["scene_flow_rate"] = np.logical_or.reduce(list(found.values()))
        return cls(scored, {name: found[name] for name in RATES[:-1] if name in rates})


class OutlierTally:
    """Counts outliers in one region, part by part.

    Parameters
    ----------
    rates
        The rates to tell, names of `RATES`.
    """

    def __init__(self, rates: Sequence[str]) -> None:
        self._found = {name: 0 for name in RATES[:-1] if name in rates}
        self._count = 0

    def add(self, outliers: Outliers, region: Mask) -> None:
        """Count those of a region."""
        here = region[outliers.scored]
        self._count += int(here.sum())
        for name in self._found:
            self._found[name] += int((outliers.flags[name] & here).sum())

    def rates(self) -> dict[str, float | int | None]:
        """Return the rates and the count; see `outlier_rates`."""
        count = self._count
        return {**{name: found / count if count else None for name, found in self._found.items()}, "count": count}


def meaningful_rates(pairs: Mapping[str, Pair], region: Mask) -> tuple[str, ...]:
    """Return the rates of outliers that can tell a good estimate from a poor one.

    Where all true disparities are alike, even a guess keeps within the thresholds, so that a rate of zero says nothing.
    A rate is meaningful if the estimate has an outlier, or if a guess would have one: the median of the truth, the same
    at every pixel. The rate of scene flow is meaningful if that of disparity or that of flow is.

    Parameters
    ----------
    pairs
        What `read_pairs` returns, shape (t, y, x).
    region
        Where to look, same shape.

    Returns
    -------
    tuple of str
        Names of `RATES` without ``count``; empty if none is meaningful, or the estimate has neither disparity nor flow.

    Examples
    --------
    >>> truth, everywhere = np.array([38.0, 38.1, 38.4]), np.ones(3, dtype=bool)
    >>> meaningful_rates({"disparity": Pair(truth + 0.01, truth)}, everywhere)
    ()
    >>> meaningful_rates({"disparity": Pair(truth + [0.0, 0.0, 9.0], truth)}, everywhere)
    ('disparity_rate',)
    """
    return meaningful_rates_of(lambda: [(pairs, region)], 1)


def meaningful_rates_of(parts: Callable[[], Iterable[tuple[Mapping[str, Pair], Mask]]], count: int) -> tuple[str, ...]:
    """Return the rates that say anything about what comes part by part; see `meaningful_rates`.

    Parameters
    ----------
    parts
        Gives pairs and region of every part, each time that it is called.
    count
        How many parts there are. Of several, every ``count``-th pixel is taken for the median that a guess would be.
    """
    truths: dict[str, list[Map]] = {}
    fails: dict[str, bool] = {}
    for pairs, region in parts():
        for part, vectors, scored in _vectors(pairs, region):
            truth = vectors.truth[:, scored]
            truths.setdefault(part, []).append(truth[:, ::count].copy())
            fails[part] = fails.get(part, False) or bool(_is_outlier(vectors.estimate[:, scored], truth).any())
    whole = {part: np.concatenate(values, axis=1) for part, values in truths.items()}
    guesses = {part: np.median(values, axis=1, keepdims=True) for part, values in whole.items() if values.size}
    for pairs, region in parts() if not all(fails.values()) else ():
        for part, vectors, scored in _vectors(pairs, region):
            if not fails[part] and part in guesses:
                truth = vectors.truth[:, scored]
                fails[part] = bool(_is_outlier(np.broadcast_to(guesses[part], truth.shape), truth).any())
    rates = [part for part in _PARTS if fails.get(part)]
    both = len(fails) == len(_PARTS)
    return (*rates, "scene_flow_rate") if rates and both else tuple(rates)


def _vectors(pairs: Mapping[str, Pair], region: Mask) -> Iterator[tuple[str, Pair, Mask]]:
    """Give the rates' quantities that are there, by rate, and where they are scored."""
    for part, names in _PARTS.items():
        if all(name in pairs for name in names):
            vectors = stacked(pairs, names)
            yield part, vectors, region & _scored(vectors)


def _scored(vectors: Pair) -> Mask:
    finite = np.isfinite(vectors.estimate).all(axis=0) & np.isfinite(vectors.truth).all(axis=0)
    return np.asarray(finite if vectors.full is None else finite & vectors.full)


def _is_outlier(estimate: Map, truth: Map) -> Mask:
    error = length(difference(estimate, truth))
    return np.asarray((error > OUTLIER_PX) & (error > OUTLIER_FRACTION * length(truth)))

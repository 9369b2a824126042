"""Spatial resolution: amplitude ratios of sinusoids, and the period at which they are attenuated by 10 %."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.benchmark.cases.case import METHOD_VALID, BenchmarkRecord, Case, CaseEstimates
from scenetruth.scoring.error_pairs import EstimateTruthPairs

__all__ = ["compute_amplitude_ratio", "compute_amplitude_records", "compute_cutoff_periods", "compute_cutoff_records"]


MIN_AMPLITUDE_RATIO = 0.9
"""Minimum amplitude ratio of a resolved period."""
_LEAST_LOG = 0.05
"""Lower bound of ratios in logarithms; smaller and negative ratios are set to it."""

Map = NDArray[np.float64]


def compute_amplitude_ratio(found: Map, true: Map) -> float:
    """Return the amplitude ratio of a sinusoid: the slope of ``found`` over ``true``, shape (n,), without their means.

    >>> wave = np.sin(np.arange(100.0))
    >>> round(compute_amplitude_ratio(0.8 * wave + 5, wave), 12)
    0.8
    """
    centred = true - true.mean()
    return float(np.sum((found - found.mean()) * centred) / np.sum(centred**2))


def compute_peak_ratio(found: Map, true: Map) -> float:
    """Return the amplitude ratio at a crest: the slope of ``found`` over ``true``, shape (n,), through the origin.

    >>> crest = np.array([0.8, 1.0, 0.8])
    >>> round(compute_peak_ratio(0.9 * crest, crest), 12)
    0.9
    """
    return float(np.sum(found * true) / np.sum(true**2))


def compute_cutoff_periods(
    periods: Sequence[float], left: Sequence[float], least: float = MIN_AMPLITUDE_RATIO
) -> tuple[float, float]:
    """Return the first and the last period at which the amplitude ratios cross ``least``, from long to short.

    Between two tested periods p, the logarithm of the ratio is interpolated linearly over 1/p², as for a Gaussian
    window. NaN counts as unresolved.

    >>> first, last = compute_cutoff_periods([80, 40, 20], [0.98, 0.95, 0.85])
    >>> round(first, 3), first == last
    (25.512, True)
    """
    order = np.argsort(periods)[::-1]
    squares = np.asarray(periods, dtype=np.float64)[order] ** -2
    shares = np.nan_to_num(np.asarray(left, dtype=np.float64)[order], nan=0.0)
    enough = shares >= least
    if enough.all():
        return 0.0, 0.0
    if not enough[0] and not enough.any():
        return float("inf"), float("inf")
    places = np.flatnonzero(enough[1:] != enough[:-1])
    found = []
    for place in places:
        one, other = np.log(np.maximum(shares[place : place + 2], _LEAST_LOG)) - np.log(least)
        crossing = squares[place] + one / (one - other) * (squares[place + 1] - squares[place])
        found.append(float(crossing**-0.5))
    if not enough[0]:
        found.insert(0, float("inf"))
    return found[0], found[-1]


MIN_VALID_FRACTION = 0.5
"""Minimum fraction of valid pixels of a resolved period."""


def compute_amplitude_records(
    case: Case, found: CaseEstimates, quantity: str, *, of_mean: bool = False
) -> Iterator[BenchmarkRecord]:
    """Yield the amplitude ratio of each method; NaN with too few valid pixels."""
    share = compute_peak_ratio if of_mean else compute_amplitude_ratio
    region = case.region_at(found.truth.isel(t=0), found.value)
    for label, estimate in found.estimates.items():
        pairs, left = EstimateTruthPairs(estimate, found.truth), math.nan
        if quantity not in pairs:
            continue
        pair = pairs[quantity]
        got, true = pair.estimate[0], pair.truth[0]
        values = region & np.isfinite(got) & (True if pair.full is None else pair.full[0])
        if np.count_nonzero(values) >= MIN_VALID_FRACTION * np.count_nonzero(region):
            left = share(got[values], true[values])
        yield BenchmarkRecord(case.kind, found.value, label, quantity, METHOD_VALID, "amplitude_ratio", left, unit="1")


def compute_cutoff_records(case: Case, rows: Sequence[BenchmarkRecord], quantity: str) -> Iterator[BenchmarkRecord]:
    """Yield the first and the last period, from long to short, at which the amplitude ratio crosses 0.9."""
    curves: dict[str, dict[float, float]] = {}
    for row in rows:
        if (row.case, row.statistic, row.quantity) == (case.kind, "amplitude_ratio", quantity):
            curves.setdefault(row.method, {})[row.level] = row.value
    for label, curve in curves.items():
        first, last = compute_cutoff_periods(list(curve), list(curve.values()))
        for name, period in (("first", first), ("last", last)):
            yield BenchmarkRecord(
                case.kind, math.nan, label, quantity, METHOD_VALID, f"cutoff_period_{name}", period, unit="px"
            )

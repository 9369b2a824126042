"""Error statistics in one region: moments, streaming quantiles, and outlier rates after the KITTI benchmark."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.error_pairs import EstimateTruthPair, stacked
from scenetruth.scoring.quantities import ErrorKind

__all__ = [
    "RATES",
    "STATISTICS",
    "STATISTIC_TITLES",
    "ErrorSamples",
    "OutlierAccumulator",
    "Outliers",
    "Statistics",
    "StatisticsAccumulator",
    "StreamingQuantiles",
    "angle_deg",
    "endpoint_statistics",
    "error_statistics",
    "meaningful_rates",
    "outlier_rates",
    "select_meaningful_rates",
    "standardised",
]


Map = NDArray[np.float64]

diverged = np.errstate(over="ignore", invalid="ignore")
"""Context and decorator for diverged estimates: overflow is silent, and non-finite statistics become None."""


@diverged
def difference(estimate: Map, truth: Map) -> Map:
    """Return estimate - truth in float64 for any input types."""
    return np.asarray(np.subtract(estimate, truth, dtype=np.float64))


@diverged
def length(vectors: Map) -> Map:
    """Return the Euclidean lengths of vectors, shape (component, ...)."""
    found: Map = np.hypot.reduce(vectors, axis=0)
    return found


@diverged
def angle_deg(one: Map, other: Map, *, lines: bool = False) -> Map:
    """Return the angles in degrees between vectors, shape (3, ...), or between undirected lines along them.

    >>> angle_deg(np.array([1.0, 1.0, 0.0]), np.array([-2.0, 0.0, 0.0])).round(6)
    np.float64(135.0)
    >>> angle_deg(np.array([1.0, 1.0, 0.0]), np.array([-2.0, 0.0, 0.0]), lines=True).round(6)
    np.float64(45.0)
    """
    along = np.einsum("k...,k...->...", one, other, dtype=np.float64)
    # Accurate also for the smallest angles, unlike the arccosine.
    across = length(np.cross(one, other, axis=0))
    found: Map = np.degrees(np.arctan2(across, np.abs(along) if lines else along))
    return found


Values = NDArray[np.float64]

# Bins per octave as a power of two, and the octaves with bins, 2^-48 to 2^48: errors in mm or px beyond this range are
# rounding errors or have diverged.
_BITS, _LOWEST, _OCTAVES = 9, -48, 96
_SHIFT = 52 - _BITS
_FIRST = (1023 + _LOWEST) << _BITS
_BINS = _OCTAVES << _BITS


class StreamingQuantiles:
    """Accumulates values and returns their quantiles.

    Quantiles of a ``single`` block are exact, with linear interpolation as in `numpy.percentile`. Several blocks are
    counted in bins whose width is 2⁻⁹ of the lower end of their octave; their quantiles are accurate to 0.2 %.

    >>> found = StreamingQuantiles(single=False)
    >>> for part in np.split(np.linspace(-1.0, 3.0, 4000), 8):
    ...     found.add(part)
    >>> [f"{value:.2f}" for value in found.at([0, 25, 75, 100])]
    ['-1.00', '-0.00', '2.00', '3.00']
    """

    def __init__(self, *, single: bool) -> None:
        self._single = single
        self._values: Values = np.empty(0)
        self._low, self._high = np.inf, -np.inf
        self._counts: dict[bool, NDArray[np.int64]] = {}

    def add(self, values: Values) -> None:
        """Accumulate a block of values without NaN."""
        if values.size == 0:
            return
        if self._single:
            self._values = values
            return
        self._low, self._high = min(self._low, float(values.min())), max(self._high, float(values.max()))
        negative = values < 0
        for below, some in ((True, -values[negative]), (False, values[~negative])):
            if some.size:
                # Positive floats are ordered like their bit patterns, whose leading bits are the octave.
                places = (some.view(np.int64) >> _SHIFT) - _FIRST
                counts = np.bincount(np.clip(places, 0, _BINS - 1), minlength=_BINS)
                self._counts[below] = self._counts[below] + counts if below in self._counts else counts

    def at(self, percent: Sequence[float]) -> list[float]:
        """Return quantiles; NaN without any values."""
        if self._single:
            values = self._values if self._values.size else np.array([np.nan])
            return [float(value) for value in np.percentile(values, percent)]
        total = sum(int(counts.sum()) for counts in self._counts.values())
        return [self._quantile((total - 1) * share / 100) if total else float("nan") for share in percent]

    def _quantile(self, rank: float) -> float:
        """Return the value at a rank, counted from 0."""
        edges, before = _edges(), 0
        for below in (True, False):
            if below not in self._counts:
                continue
            counts = self._counts[below][:: -1 if below else 1]
            upto = before + np.cumsum(counts)
            place = int(np.searchsorted(upto, rank, side="right"))
            if place < len(counts):
                part = (rank - (upto[place] - counts[place]) + 0.5) / counts[place]
                near, far = (_BINS - place, _BINS - place - 1) if below else (place, place + 1)
                start, end = (-edges[near], -edges[far]) if below else (edges[near], edges[far])
                value = start + part * (end - start) if np.isfinite(end - start) else (start if below else end)
                return float(min(max(value, self._low), self._high))
            before = int(upto[-1])
        return self._high


def _edges() -> Values:
    """Return the edges of the bins of positive values; the first bin starts at zero, the last is unbounded."""
    edges = ((np.arange(_BINS + 1, dtype=np.int64) + _FIRST) << _SHIFT).view(np.float64).copy()
    edges[0], edges[-1] = 0.0, np.inf
    return edges


Mask = NDArray[np.bool_]
Statistics = dict[str, float | int | None]
"""JSON values by name: floats, the integer ``count``, and None where undefined."""

STATISTICS = (
    "bias",
    "rmse",
    "median_abs_error",
    "p95_abs_error",
    "relative_rmse",
    "rms_z",
    "coverage_2_std",
    "density",
    "count",
)
"""The statistics of an error, in the order of reports."""


STATISTIC_TITLES: Mapping[str, str] = {
    "rmse": "RMSE",
    "bias": "bias",
    "precision_std": "standard deviation",
    "noise_std": "standard deviation due to noise",
    "median_abs_error": "median absolute error",
    "scaled_median_abs_error": "scaled median absolute error",
    "p95_abs_error": "95th percentile of the absolute error",
    "relative_rmse": "relative RMSE",
    "rms_z": "RMS of the normalised error",
    "coverage": "coverage",
    "coverage_2_std": "coverage at 2 standard deviations",
    "bias_z": "bias over its standard deviation",
    "rms_z_pixel": "RMS of the normalised error without the common part",
    "density": "density",
    "count": "scored pixels",
    "inlier_rate": "inlier rate",
    "sparsification_rmse": "RMSE of the most certain pixels",
    "amplitude_ratio": "amplitude ratio",
    "cutoff_period_first": "finest period with 90 % of the amplitude",
    "cutoff_period_last": "finest period with 90 % of the amplitude, last crossing",
    "metrological_efficiency_first": "noise × finest period (metrological efficiency indicator)",
    "metrological_efficiency_last": "noise × finest period, last crossing",
}
"""Titles of all statistics of scores, benchmarks, sweeps, predictions, design objectives and tolerances of tests."""


def error_statistics(
    estimate: Map, truth: Map, region: Mask, full: Mask | None = None, std: Map | None = None
) -> Statistics:
    """Return the statistics of the errors of a scalar quantity in one region.

    A pixel of the region is scored where truth and estimate are finite and ``full`` is True. Over the n scored pixels,
    with e_i = estimate - truth,

    - ``bias`` = Σ e_i / n,
    - ``rmse`` = (Σ e_i² / n)^½,
    - ``median_abs_error`` and ``p95_abs_error``: the median and the 95th percentile of abs(e_i), linear interpolation,
    - ``relative_rmse`` = ``rmse`` / (Σ truth_i² / n)^½, None where the truth is zero throughout,
    - ``rms_z`` = (Σ (e_i / std_i)² / m)^½ over the m pixels whose standard deviation is finite and positive:
      1 if the stated uncertainties are correct, above 1 if they are too small (overconfident),
    - ``coverage_2_std``: the fraction of these m with abs(e_i) ≤ 2 std_i; nominal 0.954 for normal errors,
    - ``density`` = n / the number of pixels of the region with a finite truth,
    - ``count`` = n.

    ``estimate``, ``truth``: The two maps, of the same shape and in the same units; NaN where undefined.
    ``region``: Mask of the region, same shape.
    ``full``: Where the estimate is valid, same shape; default: everywhere.
    ``std``: The standard deviation that the estimate states, same shape and units.

    >>> everywhere = np.ones(3, dtype=bool)
    >>> error_statistics(np.array([1.5, 2.5, np.nan]), np.array([1.0, 2.0, 3.0]), everywhere)["bias"]
    0.5
    """
    return _statistics(ErrorSamples.of(EstimateTruthPair(estimate, truth, full, std)), region)


def endpoint_statistics(estimate: Map, truth: Map, region: Mask, full: Mask | None = None) -> Statistics:
    """Return the statistics of the Euclidean distance between two vector maps (component, ...) in one region.

    As `error_statistics`, with e_i = ‖estimate_i - truth_i‖ ≥ 0 (so ``bias`` is the mean distance) and the RMS of
    ‖truth_i‖ as the reference of ``relative_rmse``. ``rms_z`` and ``coverage_2_std`` are None.
    """
    return _statistics(ErrorSamples.of(EstimateTruthPair(estimate, truth, full), "distance"), region)


@diverged
def standardised(error: Map, std: Map) -> Map:
    """Return normalised errors: error / std where the standard deviation is finite and positive, shape (m,).

    >>> standardised(np.array([3.0, 1.0, 1.0]), np.array([2.0, 0.0, np.nan])).tolist()
    [1.5]
    """
    usable = np.isfinite(std) & (std > 0)
    ratio: Map = error[usable] / std[usable]
    return ratio


@dataclass(frozen=True)
class ErrorSamples:
    """The errors of one quantity at the scored pixels.

    ``known``, ``scored``: Masks of finite truth and of scored pixels; the other arrays hold the scored pixels.
    ``error``, ``expected``: Errors, distances or angles, and true values or lengths (0 for angles).
    """

    known: Mask
    scored: Mask
    error: Map
    expected: Map
    std: Map | None

    @classmethod
    def of(cls, pair: EstimateTruthPair, error: ErrorKind = "difference") -> ErrorSamples:
        """Return the errors of a quantity; for distances and angles, the components come first."""
        known: Mask = np.isfinite(pair.truth)
        finite: Mask = np.isfinite(pair.estimate)
        if error != "difference":
            known, finite = np.asarray(known.all(axis=0)), np.asarray(finite.all(axis=0))
        scored: Mask = known & finite
        if pair.full is not None:
            scored &= pair.full
        found, expected = pair.estimate[..., scored], pair.truth[..., scored]
        std = None if pair.std is None else pair.std[scored]
        if error == "difference":
            return cls(known, scored, difference(found, expected), expected, std)
        if error == "distance":
            return cls(known, scored, length(difference(found, expected)), length(expected), std)
        return cls(known, scored, angle_deg(found, expected, lines=error == "axis_angle"), np.zeros(scored.sum()), std)


class StatisticsAccumulator:
    """Accumulates the statistics of one quantity in one region; exact quantiles for a ``single`` block."""

    def __init__(self, *, single: bool) -> None:
        self._known = self._count = self._within = 0
        self._total = 0.0
        self._errors, self._truths, self._ratios = _Squares(), _Squares(), _Squares()
        self._sizes = StreamingQuantiles(single=single)

    @diverged
    def add(self, scored: ErrorSamples, region: Mask) -> None:
        """Accumulate the pixels of a region."""
        self._known += int((region & scored.known).sum())
        here = region[scored.scored]
        error = scored.error[here]
        if not error.size:
            return
        self._count += error.size
        self._total += float(error.sum())
        self._errors.add(error)
        self._truths.add(scored.expected[here])
        self._sizes.add(np.abs(error))
        if scored.std is not None:
            ratio = standardised(error, scored.std[here])
            self._ratios.add(ratio)
            self._within += int((np.abs(ratio) <= 2).sum())

    @diverged
    def statistics(self) -> Statistics:
        """Return the accumulated statistics; see `error_statistics`."""
        if self._count == 0:
            return dict.fromkeys(STATISTICS, None) | {"density": 0.0 if self._known else None, "count": 0}
        median, p95 = self._sizes.at([50, 95])
        rms, reference, ratios = self._errors.rms, self._truths.rms, self._ratios
        return {
            "bias": _finite_or_none(self._total / self._count),
            "rmse": _finite_or_none(rms),
            "median_abs_error": _finite_or_none(median),
            "p95_abs_error": _finite_or_none(p95),
            "relative_rmse": _finite_or_none(rms / reference) if reference else None,
            "rms_z": _finite_or_none(ratios.rms) if ratios.count else None,
            "coverage_2_std": self._within / ratios.count if ratios.count else None,
            "density": self._count / self._known,
            "count": self._count,
        }


class _Squares:
    """Root mean square, scaled by the largest value to avoid overflow for diverged estimates."""

    def __init__(self) -> None:
        self.count, self._peak, self._sum = 0, 0.0, 0.0

    def add(self, values: Map) -> None:
        if not values.size:
            return
        self.count += values.size
        peak = max(self._peak, float(np.max(np.abs(values))))
        if 0 < peak < math.inf:
            before = self._sum * (self._peak / peak) ** 2
            self._sum = before + float(np.sum((values / peak) ** 2))
        self._peak = peak

    @property
    def rms(self) -> float:
        if not 0 < self._peak < math.inf:
            return self._peak
        return self._peak * math.sqrt(self._sum / self.count)


def _statistics(scored: ErrorSamples, region: Mask) -> Statistics:
    tally = StatisticsAccumulator(single=True)
    tally.add(scored, region)
    return tally.statistics()


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


RATES = ("disparity_rate", "flow_rate", "scene_flow_rate", "count")
"""The outlier statistics, in the order of reports."""
OUTLIER_PX = 3.0
"""Error above which a value may be an outlier, px."""
OUTLIER_FRACTION = 0.05
"""Error above which a value may be an outlier, as a fraction of the true magnitude; both must be exceeded."""
_PARTS: Mapping[str, tuple[str, ...]] = {"disparity_rate": ("disparity",), "flow_rate": ("flow_x", "flow_y")}
"""The quantities of each rate; the scene-flow rate uses all of them."""


def outlier_rates(
    pairs: Mapping[str, EstimateTruthPair], rates: Sequence[str] = RATES[:-1]
) -> dict[str, float | int | None]:
    """Return the outlier rates of the KITTI scene flow benchmark (Menze and Geiger, CVPR 2015).

    A disparity is an outlier if its error exceeds 3 px and 5 % of the true magnitude; a flow, if its endpoint error
    exceeds 3 px and 5 % of the true length; scene flow, if either is. All rates refer to the same pixels, those where
    all required quantities are scored.

    ``pairs``: By name: ``disparity`` in px/step, ``flow_x`` and ``flow_y`` in px/frame, any shape.

    >>> disparity = EstimateTruthPair(np.array([10.0, 14.0]), np.array([10.0, 10.0]))
    >>> outlier_rates({"disparity": disparity}, ["disparity_rate"])
    {'disparity_rate': 0.5, 'count': 2}
    """
    tally = OutlierAccumulator(rates)
    found = Outliers.of(pairs, rates)
    tally.add(found, np.ones_like(found.scored))
    return tally.rates()


@dataclass(frozen=True)
class Outliers:
    """Mask of the pixels where all required quantities are scored, and outlier flags of these pixels by rate."""

    scored: Mask
    flags: Mapping[str, Mask]

    @classmethod
    def of(cls, pairs: Mapping[str, EstimateTruthPair], rates: Sequence[str]) -> Outliers:
        """Return the outliers; parameters as in `outlier_rates`."""
        parts = [part for part in _PARTS if part in rates or "scene_flow_rate" in rates]
        vectors = {part: stacked(pairs, _PARTS[part]) for part in parts}
        scored = np.logical_and.reduce([_scored(vector) for vector in vectors.values()])
        found = {
            part: _is_outlier(vector.estimate[:, scored], vector.truth[:, scored]) for part, vector in vectors.items()
        }
        found["scene_flow_rate"] = np.logical_or.reduce(list(found.values()))
        return cls(scored, {name: found[name] for name in RATES[:-1] if name in rates})


class OutlierAccumulator:
    """Counts outliers in one region, block by block, for the given ``rates`` of `RATES`."""

    def __init__(self, rates: Sequence[str]) -> None:
        self._found = {name: 0 for name in RATES[:-1] if name in rates}
        self._count = 0

    def add(self, outliers: Outliers, region: Mask) -> None:
        """Count the outliers of a region."""
        here = region[outliers.scored]
        self._count += int(here.sum())
        for name in self._found:
            self._found[name] += int((outliers.flags[name] & here).sum())

    def rates(self) -> dict[str, float | int | None]:
        """Return the rates and the count; see `outlier_rates`."""
        count = self._count
        return {**{name: found / count if count else None for name, found in self._found.items()}, "count": count}


def meaningful_rates(pairs: Mapping[str, EstimateTruthPair], region: Mask) -> tuple[str, ...]:
    """Return the outlier rates that can distinguish a good estimate from a poor one.

    If the true values vary by less than the thresholds, even a constant estimate has no outliers. A rate is meaningful
    if the estimate has an outlier, or if a constant estimate, the median of the truth, would have one. The scene-flow
    rate is meaningful if the disparity rate or the flow rate is.

    ``pairs``: Estimate and truth by quantity, shape (t, y, x). ``region``: Mask of the same shape.

    >>> truth, everywhere = np.array([38.0, 38.1, 38.4]), np.ones(3, dtype=bool)
    >>> meaningful_rates({"disparity": EstimateTruthPair(truth + 0.01, truth)}, everywhere)
    ()
    >>> meaningful_rates({"disparity": EstimateTruthPair(truth + [0.0, 0.0, 9.0], truth)}, everywhere)
    ('disparity_rate',)
    """
    return select_meaningful_rates(lambda: [(pairs, region)], 1)


def select_meaningful_rates(
    parts: Callable[[], Iterable[tuple[Mapping[str, EstimateTruthPair], Mask]]], count: int
) -> tuple[str, ...]:
    """Return the meaningful rates of data that come in ``count`` blocks; see `meaningful_rates`."""
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


def _vectors(pairs: Mapping[str, EstimateTruthPair], region: Mask) -> Iterator[tuple[str, EstimateTruthPair, Mask]]:
    """Yield the available quantities of each rate and the pixels where they are scored."""
    for part, names in _PARTS.items():
        if all(name in pairs for name in names):
            vectors = stacked(pairs, names)
            yield part, vectors, region & _scored(vectors)


def _scored(vectors: EstimateTruthPair) -> Mask:
    finite = np.isfinite(vectors.estimate).all(axis=0) & np.isfinite(vectors.truth).all(axis=0)
    return np.asarray(finite if vectors.full is None else finite & vectors.full)


def _is_outlier(estimate: Map, truth: Map) -> Mask:
    error = length(difference(estimate, truth))
    return np.asarray((error > OUTLIER_PX) & (error > OUTLIER_FRACTION * length(truth)))

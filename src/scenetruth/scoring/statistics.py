"""The statistics of errors in one region."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.differences import angle_deg, difference, diverged, length
from scenetruth.scoring.quantiles import Quantiles
from scenetruth.scoring.quantities import ErrorKind
from scenetruth.scoring.reading import Pair

__all__ = [
    "STATISTICS",
    "Scored",
    "Statistics",
    "Tally",
    "endpoint_statistics",
    "error_statistics",
    "standardised",
]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
Statistics = dict[str, float | int | None]
"""Values by name, ready for JSON: floats, the integer ``count``, and None where there is nothing to tell."""

STATISTICS = (
    "bias",
    "rms",
    "median_abs",
    "p95_abs",
    "relative_rms",
    "calibration",
    "within_2_std",
    "density",
    "count",
)
"""The statistics of an error, in the order in which they are reported."""


def error_statistics(
    estimate: Map, truth: Map, region: Mask, full: Mask | None = None, std: Map | None = None
) -> Statistics:
    """Return the statistics of the errors of a scalar quantity in one region.

    A pixel of the region is scored where the truth is finite, the estimate is finite, and ``full`` holds. Over the n
    scored pixels, with e_i = estimate - truth,

    - ``bias`` = Σ e_i / n,
    - ``rms`` = (Σ e_i² / n)^½,
    - ``median_abs`` and ``p95_abs``, the median and the 95th percentile of abs(e_i), interpolated linearly,
    - ``relative_rms`` = ``rms`` / (Σ truth_i² / n)^½, None where the truth vanishes throughout,
    - ``calibration`` = (Σ (e_i / std_i)² / m)^½ over the m of them whose standard deviation is finite and positive:
      1 if the error bars are right, above 1 if they are too small (overconfident),
    - ``within_2_std``, the share of those m with abs(e_i) ≤ 2 std_i: 0.954 of normal errors with the right error bars,
    - ``density`` = n / the number of pixels of the region with a finite truth,
    - ``count`` = n.

    Parameters
    ----------
    estimate, truth
        The two maps, of the same shape and in the same units; NaN where there is none.
    region
        Where to look, same shape.
    full
        Where the estimate claims to know the quantity, same shape; everywhere if not given.
    std
        The standard deviation that the estimate states, same shape and units.

    Returns
    -------
    dict
        By the names of `STATISTICS`. With no scored pixel, everything is None but ``count`` = 0 and ``density`` = 0;
        with no true pixel either, the density is None as well. Without any usable standard deviation, ``calibration``
        and ``within_2_std`` are None.

    Examples
    --------
    >>> everywhere = np.ones(3, dtype=bool)
    >>> error_statistics(np.array([1.5, 2.5, np.nan]), np.array([1.0, 2.0, 3.0]), everywhere)["bias"]
    0.5
    """
    return _statistics(Scored.of(Pair(estimate, truth, full, std)), region)


def endpoint_statistics(estimate: Map, truth: Map, region: Mask, full: Mask | None = None) -> Statistics:
    """Return the statistics of the Euclidean distance between two vector maps in one region.

    As `error_statistics`, with e_i = ‖estimate_i - truth_i‖ ≥ 0 (so ``bias`` is the mean distance) and with the
    rms of ‖truth_i‖ as the reference of ``relative_rms``. All components must be finite at a scored pixel. A distance
    has no standard deviation, so that ``calibration`` and ``within_2_std`` are None.

    Parameters
    ----------
    estimate, truth
        The two maps, shape (component, ...), in the same units; NaN where there is none.
    region, full
        As in `error_statistics`, shape (...).

    Returns
    -------
    dict
        By the names of `STATISTICS`.
    """
    return _statistics(Scored.of(Pair(estimate, truth, full), "distance"), region)


@diverged
def standardised(error: Map, std: Map) -> Map:
    """Return errors in units of their standard deviation.

    Parameters
    ----------
    error, std
        Errors and their standard deviations, of the same shape and in the same units.

    Returns
    -------
    numpy.ndarray
        error / std, a plain number, of those with a finite, positive standard deviation; shape (m,).

    Examples
    --------
    >>> standardised(np.array([3.0, 1.0, 1.0]), np.array([2.0, 0.0, np.nan])).tolist()
    [1.5]
    """
    usable = np.isfinite(std) & (std > 0)
    ratio: Map = error[usable] / std[usable]
    return ratio


@dataclass(frozen=True)
class Scored:
    """The errors of one quantity, at the pixels that are scored.

    Parameters
    ----------
    known
        Where the truth is known, a map.
    scored
        Where estimate and truth are both known, a map; the following belong to these pixels, in their order.
    error, expected
        Errors, distances or angles, and true values or lengths; 0 for angles, which have nothing to compare with.
    std
        The standard deviations that the estimate states, or None.
    """

    known: Mask
    scored: Mask
    error: Map
    expected: Map
    std: Map | None

    @classmethod
    def of(cls, pair: Pair, error: ErrorKind = "difference") -> Scored:
        """Return the errors of a quantity: vectors, of which distances and angles are taken, have components first."""
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


class Tally:
    """Gathers the statistics of one quantity in one region, part by part.

    Parameters
    ----------
    single
        Whether there is one part only: medians and percentiles are exact then (see `Quantiles`).
    """

    def __init__(self, *, single: bool) -> None:
        self._known = self._count = self._within = 0
        self._total = 0.0
        self._errors, self._truths, self._ratios = _Squares(), _Squares(), _Squares()
        self._sizes = Quantiles(single=single)

    @diverged
    def add(self, scored: Scored, region: Mask) -> None:
        """Count the pixels of a region."""
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
        """Return the statistics of what was counted; see `error_statistics`."""
        if self._count == 0:
            return dict.fromkeys(STATISTICS, None) | {"density": 0.0 if self._known else None, "count": 0}
        median, p95 = self._sizes.at([50, 95])
        rms, reference, ratios = self._errors.rms, self._truths.rms, self._ratios
        return {
            "bias": _finite_or_none(self._total / self._count),
            "rms": _finite_or_none(rms),
            "median_abs": _finite_or_none(median),
            "p95_abs": _finite_or_none(p95),
            "relative_rms": _finite_or_none(rms / reference) if reference else None,
            "calibration": _finite_or_none(ratios.rms) if ratios.count else None,
            "within_2_std": self._within / ratios.count if ratios.count else None,
            "density": self._count / self._known,
            "count": self._count,
        }


class _Squares:
    """The root of the mean of squares, scaled by the largest value, so that those of diverged estimates are finite."""

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


def _statistics(scored: Scored, region: Mask) -> Statistics:
    tally = Tally(single=True)
    tally.add(scored, region)
    return tally.statistics()


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None

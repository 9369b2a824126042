"""The statistics of errors in one region."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.differences import difference, diverged, length
from scenetruth.scoring.outliers import outlier_rates
from scenetruth.scoring.quantities import ENDPOINT, OUTLIERS, QUANTITIES, Pair, stacked

__all__ = [
    "STATISTICS",
    "Statistics",
    "endpoint_statistics",
    "error_statistics",
    "region_statistics",
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
    known = region & np.isfinite(truth)
    scored = known & np.isfinite(estimate)
    if full is not None:
        scored &= full
    expected = truth[scored]
    error = difference(estimate[scored], expected)
    return _summary(error, expected, int(known.sum()), None if std is None else std[scored])


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
    known = region & np.isfinite(truth).all(axis=0)
    scored = known & np.isfinite(estimate).all(axis=0)
    if full is not None:
        scored &= full
    expected = truth[:, scored]
    return _summary(length(difference(estimate[:, scored], expected)), length(expected), int(known.sum()))


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


def region_statistics(pairs: Mapping[str, Pair], region: Mask, rates: Sequence[str] = ()) -> dict[str, Statistics]:
    """Return the statistics of every quantity in one region.

    Parameters
    ----------
    pairs
        What `read_pairs` returns, and perhaps further scalar quantities by their names.
    region
        Where to look, shape (t, y, x).
    rates
        The rates of outliers to report: what `meaningful_rates` returns.

    Returns
    -------
    dict
        The quantity's name to its statistics: the keys of `QUANTITIES` that are there, ``velocity_endpoint`` where
        there is a velocity, further quantities, and ``outliers`` if there are rates to report.
    """
    # Regions may be many and small: only their own pixels are looked at.
    here = {name: pair.at(region) for name, pair in pairs.items()}
    everywhere = np.ones(int(region.sum()), dtype=bool)
    single = {
        name: error_statistics(pair.estimate, pair.truth, everywhere, pair.full, pair.std)
        for name, pair in here.items()
    }
    result = {name: values for name, values in single.items() if name in QUANTITIES}
    if "velocity_z" in here:
        velocity = stacked(here, ("velocity_x", "velocity_y", "velocity_z"))
        result[ENDPOINT] = endpoint_statistics(velocity.estimate, velocity.truth, everywhere, velocity.full)
    result |= {name: values for name, values in single.items() if name not in QUANTITIES}
    if rates:
        result[OUTLIERS] = outlier_rates(here, rates)
    return result


@diverged
def _summary(error: Map, expected: Map, known: int, std: Map | None = None) -> Statistics:
    count = error.size
    if count == 0:
        return dict.fromkeys(STATISTICS, None) | {"density": 0.0 if known else None, "count": 0}
    size = np.abs(error)
    median, p95 = np.percentile(size, [50, 95])
    rms, reference = _rms(error), _rms(expected)
    values: Statistics = {
        "bias": _finite_or_none(float(error.mean())),
        "rms": _finite_or_none(rms),
        "median_abs": _finite_or_none(float(median)),
        "p95_abs": _finite_or_none(float(p95)),
        "relative_rms": _finite_or_none(rms / reference) if reference else None,
    }
    return values | _error_bars(error, std) | {"density": count / known, "count": count}


@diverged
def _error_bars(error: Map, std: Map | None) -> Statistics:
    ratio = standardised(error, std) if std is not None else error[:0]
    if ratio.size == 0:
        return {"calibration": None, "within_2_std": None}
    return {"calibration": _finite_or_none(_rms(ratio)), "within_2_std": float(np.mean(np.abs(ratio) <= 2))}


def _rms(values: Map) -> float:
    # Scaled by the largest value, so that the squares of a diverged estimate do not overflow.
    peak = float(np.max(np.abs(values)))
    if not 0 < peak < math.inf:
        return peak
    return peak * math.sqrt(float(np.mean((values / peak) ** 2)))


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None

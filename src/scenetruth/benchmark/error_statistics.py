"""Error statistics: bootstrap confidence intervals, stated uncertainty, growth, metrological efficiency."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.benchmark.cases.case import (
    ALL,
    BOUND,
    COMMON_VALID,
    METHOD_VALID,
    NOISE_STD,
    BenchmarkRecord,
    Case,
    CaseEstimates,
)
from scenetruth.random_streams import generator_for
from scenetruth.scoring import get_units
from scenetruth.scoring.error_pairs import EstimateTruthPairs
from scenetruth.scoring.growth_rate import compute_growth_pairs, has_growth_rate
from scenetruth.settings import ScoreSettings

__all__ = [
    "COVERAGE_FACTORS",
    "INLIER_PX",
    "IntervalStatistic",
    "compute_coverage",
    "compute_efficiency_records",
    "compute_growth_records",
    "compute_interval_statistics",
    "compute_rms_z",
    "compute_sparsification",
    "compute_statistic_records",
]


BLOCK_PX = 18
"""Side of a block: three standard deviations of the default window, beyond which errors are independent."""
_DRAWS = 400
_FEWEST_BLOCKS = 6
"""Minimum number of blocks for a confidence interval."""

Map = NDArray[np.float64]


@dataclass(frozen=True)
class IntervalStatistic:
    """A statistic with its 95 % confidence interval, NaN with too few blocks."""

    value: float
    ci_low: float = float("nan")
    ci_high: float = float("nan")


def compute_interval_statistics(errors: Map, kept: NDArray[np.bool_]) -> dict[str, IntervalStatistic]:
    """Return bias, RMSE, standard deviation and median absolute error of the ``kept`` errors (seed, y, x)."""
    values = errors[kept]
    if not values.size:
        return {}
    blocks, number = _number_blocks(kept)
    median = float(np.median(np.abs(values)))
    count = np.bincount(blocks, minlength=number).astype(np.float64)
    sums = [np.bincount(blocks, each, number).astype(np.float64) for each in (values, values**2)]
    found = {
        name: IntervalStatistic(float(each(count.sum(), *(one.sum() for one in sums))))
        for name, each in _FIGURES.items()
    }
    found["median_abs_error"] = IntervalStatistic(median)
    if number >= _FEWEST_BLOCKS:
        drawn = generator_for(0, "blocks", number).multinomial(number, np.full(number, 1 / number), size=_DRAWS)
        with np.errstate(invalid="ignore", divide="ignore"):
            totals: list[Map] = [drawn @ one for one in (count, *sums)]
            for name, each in _FIGURES.items():
                low, high = np.nanpercentile(each(*totals), [2.5, 97.5])
                found[name] = IntervalStatistic(found[name].value, float(low), float(high))
    return found


def _number_blocks(kept: NDArray[np.bool_]) -> tuple[NDArray[np.intp], int]:
    """Return the block index of every evaluated pixel, and the number of non-empty blocks."""
    seed, y, x = np.nonzero(kept)
    wide = kept.shape[2] // BLOCK_PX + 1
    high = kept.shape[1] // BLOCK_PX + 1
    names, number = np.unique((seed * high + y // BLOCK_PX) * wide + x // BLOCK_PX, return_inverse=True)
    return number, len(names)


def _rms(count: Map, total: Map, squares: Map) -> Map:
    return np.sqrt(squares / count)


def _std(count: Map, total: Map, squares: Map) -> Map:
    return np.sqrt(np.maximum(squares / count - (total / count) ** 2, 0.0))


_FIGURES: Mapping[str, Callable[[Map, Map, Map], Map]] = {
    "bias": lambda count, total, squares: total / count,
    "rmse": _rms,
    "precision_std": _std,
}


SPARSIFICATION_FRACTIONS: Sequence[float] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Fractions of the most certain pixels in sparsification curves."""
COVERAGE_FACTORS: Sequence[float] = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Numbers of stated standard deviations in coverage curves."""


def compute_sparsification(errors: Map, std: Map, kept: Sequence[float] = SPARSIFICATION_FRACTIONS) -> list[float]:
    """Return the RMSE of the most certain of n pixels, for each fraction.

    >>> compute_sparsification(np.array([1.0, 3.0]), np.array([0.1, 0.2]), [0.5, 1.0])
    [1.0, 2.23606797749979]
    """
    squares = np.square(errors[np.argsort(std, kind="stable")])
    means = np.cumsum(squares) / np.arange(1, len(squares) + 1)
    places = np.maximum(np.ceil(np.asarray(kept) * len(squares)).astype(int), 1) - 1
    return [float(value) for value in np.sqrt(means[places])]


def compute_coverage(errors: Map, std: Map, within: Sequence[float] = COVERAGE_FACTORS) -> list[float]:
    """Return the fraction of errors within each number of stated standard deviations."""
    scaled = np.abs(errors) / std
    return [float(np.mean(scaled <= number)) for number in within]


def compute_rms_z(errors: Map, std: Map) -> float:
    """Return the RMS of error over stated standard deviation; above 1 the method is overconfident."""
    return float(np.sqrt(np.mean(np.square(errors / std))))


INLIER_PX = 0.1
"""Largest error of an inlier, in px/step or px/frame."""
_IN_PX = ("disparity", "flow_x", "flow_y")

Mask = NDArray[np.bool_]


def compute_statistic_records(case: Case, value: float, found: Sequence[CaseEstimates]) -> Iterator[BenchmarkRecord]:
    """Yield the records of all methods at one level."""
    region = case.region_at(found[0].truth.isel(t=0), value)
    for quantity in case.quantities:
        errors, entries, std = _stacks(found, quantity, region)
        common = np.logical_and.reduce(list(entries.values())) if entries else np.zeros(0, dtype=bool)
        for label, known in entries.items():
            rows = _compute_rows(errors[label], known, common, region, std.get(label), alone=len(entries) == 1)
            for pixels, statistic, size, at in rows:
                unit = "1" if statistic in _SHARES else get_units(quantity)
                if quantity in _IN_PX or statistic != "inlier_rate":
                    yield BenchmarkRecord(
                        case.kind,
                        value,
                        label,
                        quantity,
                        pixels,
                        statistic,
                        size.value,
                        size.ci_low,
                        size.ci_high,
                        at,
                        unit,
                    )


_SHARES = ("density", "inlier_rate", "coverage", "rms_z")


def _stacks(
    found: Sequence[CaseEstimates], quantity: str, region: Mask
) -> tuple[dict[str, Map], dict[str, Mask], dict[str, Map]]:
    """Return errors, validity masks and stated standard deviations by method, shape (seed, y, x)."""
    errors: dict[str, list[Map]] = {}
    entries: dict[str, list[Mask]] = {}
    stated: dict[str, list[Map]] = {}
    for one in found:
        for label, estimate in one.estimates.items():
            pairs = EstimateTruthPairs(estimate, one.truth)
            if quantity not in pairs:
                continue
            pair = pairs[quantity]
            with np.errstate(invalid="ignore"):
                error = pair.estimate[0] - pair.truth[0]
            known = region & np.isfinite(error) & (True if pair.full is None else pair.full[0])
            errors.setdefault(label, []).append(np.where(known, error, 0.0))
            entries.setdefault(label, []).append(known)
            if pair.std is not None:
                stated.setdefault(label, []).append(pair.std[0])
    return (
        {label: np.stack(maps) for label, maps in errors.items()},
        {label: np.stack(maps) for label, maps in entries.items()},
        {label: np.stack(maps) for label, maps in stated.items() if len(maps) == len(errors[label])},
    )


def _compute_rows(
    errors: Map, known: Mask, common: Mask, region: Mask, std: Map | None, *, alone: bool
) -> Iterator[tuple[str, str, IntervalStatistic, float]]:
    """Yield (pixels, statistic, value, threshold) of one method and quantity."""
    there = len(errors) * np.count_nonzero(region)
    if not there:
        return
    yield METHOD_VALID, "density", IntervalStatistic(np.count_nonzero(known) / there), math.nan
    good = np.count_nonzero(known & (np.abs(errors) <= INLIER_PX))
    yield ALL, "inlier_rate", IntervalStatistic(good / there), math.nan
    for name, size in compute_interval_statistics(errors, known).items():
        yield METHOD_VALID, name, size, math.nan
    if not alone:
        for name, size in compute_interval_statistics(errors, common).items():
            yield COMMON_VALID, name, size, math.nan
    noise = _noise(errors, known)
    if noise is not None:
        yield METHOD_VALID, "noise_std", noise, math.nan
    if std is None:
        return
    kept = known & np.isfinite(std) & (std > 0)
    if not kept.any():
        return
    off, bars = errors[kept], std[kept]
    yield METHOD_VALID, "rms_z", IntervalStatistic(compute_rms_z(off, bars)), math.nan
    for at, share in zip(COVERAGE_FACTORS, compute_coverage(off, bars), strict=True):
        yield METHOD_VALID, "coverage", IntervalStatistic(share), at
    for at, left in zip(SPARSIFICATION_FRACTIONS, compute_sparsification(off, bars), strict=True):
        yield METHOD_VALID, "sparsification_rmse", IntervalStatistic(left), at


def _noise(errors: Map, known: Mask) -> IntervalStatistic | None:
    """Return the root mean variance over noise realisations, of always valid pixels; None for one realisation."""
    count = len(errors)
    always: Mask = np.asarray(known.all(axis=0))
    if count < 2 or not always.any():
        return None
    variance = errors[:, always].var(axis=0, ddof=1)
    # The same bootstrap as for errors, averaging squares.
    deviations = np.zeros(always.shape)
    deviations[always] = np.sqrt(variance)
    return compute_interval_statistics(deviations[None], always[None])["rmse"]


def group_by_case(rows: Sequence[BenchmarkRecord]) -> Mapping[str, list[BenchmarkRecord]]:
    """Return records by case."""
    found: dict[str, list[BenchmarkRecord]] = {}
    for row in rows:
        found.setdefault(row.case, []).append(row)
    return found


def compute_growth_records(case: Case, found: CaseEstimates) -> Iterator[BenchmarkRecord]:
    """Yield the error statistics of windowed growth, for methods that estimate depth and velocity."""
    region = case.region_at(found.truth.isel(t=0), found.value)
    for label, estimate in found.estimates.items():
        if not has_growth_rate(estimate, found.truth):
            continue
        for quantity, pair in compute_growth_pairs(estimate, found.truth, ScoreSettings()).items():
            kept = region & np.isfinite(pair.estimate[0]) & np.isfinite(pair.truth[0])
            kept &= True if pair.full is None else pair.full[0]
            errors = np.where(kept, pair.estimate[0] - pair.truth[0], 0.0)
            for statistic, size in compute_interval_statistics(errors[None], kept[None]).items():
                yield BenchmarkRecord(
                    case.kind,
                    found.value,
                    label,
                    quantity,
                    METHOD_VALID,
                    statistic,
                    size.value,
                    size.ci_low,
                    size.ci_high,
                    unit="%/h",
                )


_PAIRS: Mapping[str, str] = {"star": "flow_y", "waves_of_motion": "flow_y", "waves_of_depth": "disparity"}
"""Quantity whose noise is combined with the resolution of each case, px times px."""
_PERIOD = "cutoff_period_"


def compute_efficiency_records(rows: Sequence[BenchmarkRecord]) -> Iterator[BenchmarkRecord]:
    """Yield the metrological efficiency indicators: noise times cut-off period, for both cut-off definitions."""
    noise = {
        (row.method, row.quantity): row.value
        for row in rows
        if row.case == "noise" and row.statistic == "noise_std" and row.method != BOUND and row.level == NOISE_STD
    }
    for row in rows:
        if row.statistic.startswith(_PERIOD) and row.case in _PAIRS:
            quantity = _PAIRS[row.case]
            product = row.value * noise.get((row.method, quantity), math.nan)
            if math.isfinite(product) and product > 0:
                reading = row.statistic.removeprefix(_PERIOD)
                yield BenchmarkRecord(
                    row.case,
                    math.nan,
                    row.method,
                    quantity,
                    METHOD_VALID,
                    f"metrological_efficiency_{reading}",
                    product,
                    unit="px²",
                )

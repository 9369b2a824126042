"""Aggregation over seeds: statistics with confidence intervals, and records of design points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.sweeps.point_simulation import (
    RetainedErrors,
    SimulationResult,
    SweepTask,
    read_retained_errors,
    read_simulation_result,
)
from scenetruth.design.sweeps.sweep_plan import SweepPlan
from scenetruth.design.sweeps.sweep_result import Sweep, SweepRecord
from scenetruth.scoring import get_units

__all__ = [
    "Interval",
    "collect_result",
    "compute_mean",
    "compute_positive_mean",
    "compute_root_mean_square",
    "compute_scatter",
]


Interval = tuple[float, float, float]
"""A statistic and the lower and upper end of its confidence interval; NaN with too few seeds."""
_LEVEL = 0.975
_LARGEST_EXPONENT = 100.0  # limit of the exponent, against overflow
_FEWEST_LEFT_OUT = 3  # fewest seeds for a jackknife interval: a variance requires two seeds after one is omitted


def compute_mean(values: Sequence[float]) -> Interval:
    """Return the mean over seeds with the confidence interval of Student's t distribution.

    >>> [round(one, 3) for one in compute_mean([1.0, 2.0, 3.0])]
    [2.0, -0.484, 4.484]
    """
    each = np.asarray(values, dtype=np.float64)
    centre = float(each.mean())
    if len(each) < 2:
        return centre, math.nan, math.nan
    half = _student(len(each) - 1) * float(each.std(ddof=1)) / math.sqrt(len(each))
    return centre, centre - half, centre + half


def compute_positive_mean(values: Sequence[float]) -> Interval:
    """Return the mean over seeds of a non-negative statistic; the interval is symmetric on a logarithmic scale.

    >>> [round(one, 3) for one in compute_positive_mean([1.0, 2.0, 3.0])]
    [2.0, 0.578, 6.926]
    """
    centre, low, _ = compute_mean(values)
    return _on_logarithm(centre, centre - low)


def compute_root_mean_square(values: Sequence[float]) -> Interval:
    """Return the root mean square over seeds; the interval is that of the logarithm of the mean square."""
    return _root(compute_positive_mean(np.square(values).tolist()))


def compute_scatter(errors: NDArray[np.floating]) -> Interval | None:
    """Return the standard deviation between seeds: the root of the mean variance over pixels.

    The interval is a jackknife interval on the logarithm of the variance (B. Efron and C. Stein, Annals of
    Statistics 9, 1981).

    ``errors``: Shape (seed, n); NaN where invalid. Only pixels that are valid with every seed are used.
    """
    always = np.isfinite(errors).all(axis=0)
    count = len(errors)
    if count < 2 or not always.any():
        return None
    kept = np.asarray(errors[:, always], dtype=np.float64)
    variance = float(kept.var(axis=0, ddof=1).mean())
    if count < _FEWEST_LEFT_OUT:
        return math.sqrt(variance), math.nan, math.nan
    without = np.array([np.delete(kept, seed, axis=0).var(axis=0, ddof=1).mean() for seed in range(count)])
    spread = math.sqrt((count - 1) / count * float(np.square(without - without.mean()).sum()))
    return _root(_on_logarithm(variance, _student(count - 1) * spread))


def _on_logarithm(centre: float, half: float) -> Interval:
    """Return the interval that is symmetric on a logarithmic scale and has the relative half width half / centre."""
    if centre <= 0:
        return centre, math.nan, math.nan
    factor = math.exp(min(half / centre, _LARGEST_EXPONENT)) if math.isfinite(half) else math.nan
    return centre, centre / factor, centre * factor


def _root(interval: Interval) -> Interval:
    number, low, high = map(math.sqrt, interval)
    return number, low, high


def _student(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, _LEVEL))


def compute_point_records(
    values: Mapping[str, Any], scene: str, found: Mapping[int, tuple[SimulationResult, Path | None]]
) -> Iterator[SweepRecord]:
    """Yield the records of a design point: every seed, all seeds together, and the bound."""
    where = (values, scene)
    pooled: dict[tuple[str, str, str, str], list[float]] = {}
    for seed, (measured, _) in found.items():
        for method, region, quantity, statistic, number in _figures(measured):
            pooled.setdefault((method, region, quantity, statistic), []).append(number)
            yield _make_record(where, method, seed, region, quantity, statistic, (number, np.nan, np.nan))
    kept = [read_retained_errors(path) for _, path in found.values() if path is not None] if len(found) > 1 else []
    scattered = set()
    for (method, region, quantity, statistic), numbers in pooled.items():
        yield _make_record(where, method, None, region, quantity, statistic, _over_seeds(statistic, numbers))
        if (method, region, quantity) in scattered:
            continue
        scattered.add((method, region, quantity))
        scatter = _scatter(kept, method, region, quantity)
        if scatter is not None:
            yield _make_record(where, method, None, region, quantity, "precision_std", scatter)
    for measured, _ in found.values():
        for name, regions in measured.bounds.items():
            for region, quantities in regions.items():
                for quantity, figures in quantities.items():
                    for statistic, number in ({"precision_std": figures["rmse"]} | figures).items():
                        yield _make_record(where, name, None, region, quantity, statistic, (number, np.nan, np.nan))


def _figures(measured: SimulationResult) -> Iterator[tuple[str, str, str, str, float]]:
    for method, regions in measured.figures.items():
        for region, quantities in regions.items():
            for quantity, figures in quantities.items():
                for statistic, number in figures.items():
                    yield method, region, quantity, statistic, number


def _over_seeds(statistic: str, numbers: Sequence[float]) -> Interval:
    if statistic == "rmse":
        return compute_root_mean_square(numbers)
    if statistic == "median_abs_error":
        return compute_positive_mean(numbers)
    number, low, high = compute_mean(numbers)
    # Densities stay between 0 and 1.
    return (number, max(low, 0.0), min(high, 1.0)) if statistic == "density" else (number, low, high)


def _scatter(kept: Sequence[RetainedErrors], method: str, region: str, quantity: str) -> Interval | None:
    entries = [one for one in kept if (method, quantity) in one.errors and (method, region) in one.regions]
    if len(entries) < 2 or len({one.errors[method, quantity].shape for one in entries}) > 1:
        return None
    inside = np.logical_and.reduce([one.regions[method, region] for one in entries])
    return compute_scatter(np.stack([one.errors[method, quantity][inside] for one in entries]))


def _make_record(
    where: tuple[Mapping[str, Any], str],
    method: str,
    seed: int | None,
    region: str,
    quantity: str,
    statistic: str,
    figure: Interval,
) -> SweepRecord:
    unit = "1" if statistic == "density" else get_units(quantity)
    return SweepRecord(*where, method, seed, region, quantity, statistic, *figure, unit)


def collect_result(job: SweepTask, keys: Sequence[str], failed: Mapping[str, str]) -> Sweep:
    """Return the result of a sweep from the stored results of its simulations."""
    plan = job.plan
    rows: list[SweepRecord] = []
    failures, notes = list(failed.values()), dict[str, None]()
    labels: dict[str, None] = dict.fromkeys(one.label for one in job.contestants)
    grows = False
    for place, point in enumerate(plan.points):
        found: dict[int, tuple[SimulationResult, Path | None]] = {}
        for number in range(place * plan.each, (place + 1) * plan.each):
            key = keys[number]
            if key in failed:
                continue
            measured, path = read_simulation_result(job, key), job.store.arrays_path(key)
            found[plan.at(number)[1]] = (measured, path if job.keeps else None)
            failures += [f"{job.label(number)}: {label}: {why}" for label, why in measured.failures.items()]
            notes |= dict.fromkeys(measured.notes)
            labels |= dict.fromkeys([*measured.figures, *measured.failures])
            grows |= measured.grows
        rows += compute_point_records(plan.values(point), plan.labels[point.scene], found)
    return Sweep(
        plan.factors,
        plan.labels,
        list(labels),
        rows,
        failures,
        [*notes, *_find_ineffective_factors(plan, rows)],
        grows=grows,
        is_grid=plan.is_grid,
        logarithmic=plan.logarithmic,
    )


def _find_ineffective_factors(plan: SweepPlan, rows: Sequence[SweepRecord]) -> Iterable[str]:
    if not plan.is_grid:
        return
    for path in plan.factors:
        seen: dict[tuple[Any, ...], set[float]] = {}
        counts: dict[tuple[Any, ...], int] = {}
        for row in rows:
            others = tuple(repr(value) for name, value in row.values.items() if name != path)
            what = (*others, row.scene, row.method, row.seed, row.region, row.quantity, row.statistic)
            seen.setdefault(what, set()).add(row.value)
            counts[what] = counts.get(what, 0) + 1
        compared = [what for what, count in counts.items() if count > 1]
        if compared and all(len(seen[what]) == 1 for what in compared):
            yield f"{path} has no effect on any statistic"

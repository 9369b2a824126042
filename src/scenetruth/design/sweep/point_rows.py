"""From the files of all simulations to the rows of a sweep: each seed's figures, and those of all seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.sweep.intervals import Interval, mean_of, root_mean_square_of, scatter_of, size_of
from scenetruth.design.sweep.kept import Kept, read_kept
from scenetruth.design.sweep.measure import Measured
from scenetruth.design.sweep.rows import Row
from scenetruth.scoring import units_of

__all__ = ["rows_of_point"]


def rows_of_point(
    values: Mapping[str, Any], scene: str, found: Mapping[int, tuple[Measured, Path | None]]
) -> Iterator[Row]:
    """Give the figures of a point.

    Parameters
    ----------
    values, scene
        The point.
    found
        What its simulations have found by seed, and the file of the errors that are kept.
    """
    where = (values, scene)
    pooled: dict[tuple[str, str, str, str], list[float]] = {}
    for seed, (measured, _) in found.items():
        for method, region, quantity, statistic, number in _figures(measured):
            pooled.setdefault((method, region, quantity, statistic), []).append(number)
            yield _row(where, method, seed, region, quantity, statistic, (number, np.nan, np.nan))
    kept = [read_kept(path) for _, path in found.values() if path is not None] if len(found) > 1 else []
    scattered = set()
    for (method, region, quantity, statistic), numbers in pooled.items():
        yield _row(where, method, None, region, quantity, statistic, _over_seeds(statistic, numbers))
        if (method, region, quantity) in scattered:
            continue
        scattered.add((method, region, quantity))
        scatter = _scatter(kept, method, region, quantity)
        if scatter is not None:
            yield _row(where, method, None, region, quantity, "std", scatter)
    for measured, _ in found.values():
        for name, regions in measured.bounds.items():
            for region, quantities in regions.items():
                for quantity, figures in quantities.items():
                    for statistic, number in ({"std": figures["rms"]} | figures).items():
                        yield _row(where, name, None, region, quantity, statistic, (number, np.nan, np.nan))


def _figures(measured: Measured) -> Iterator[tuple[str, str, str, str, float]]:
    for method, regions in measured.figures.items():
        for region, quantities in regions.items():
            for quantity, figures in quantities.items():
                for statistic, number in figures.items():
                    yield method, region, quantity, statistic, number


def _over_seeds(statistic: str, numbers: Sequence[float]) -> Interval:
    if statistic == "rms":
        return root_mean_square_of(numbers)
    if statistic == "median":
        return size_of(numbers)
    number, low, high = mean_of(numbers)
    # Shares stay shares.
    return (number, max(low, 0.0), min(high, 1.0)) if statistic == "density" else (number, low, high)


def _scatter(kept: Sequence[Kept], method: str, region: str, quantity: str) -> Interval | None:
    told = [one for one in kept if (method, quantity) in one.errors and (method, region) in one.regions]
    if len(told) < 2 or len({one.errors[method, quantity].shape for one in told}) > 1:
        return None
    inside = np.logical_and.reduce([one.regions[method, region] for one in told])
    return scatter_of(np.stack([one.errors[method, quantity][inside] for one in told]))


def _row(
    where: tuple[Mapping[str, Any], str],
    method: str,
    seed: int | None,
    region: str,
    quantity: str,
    statistic: str,
    figure: Interval,
) -> Row:
    unit = "1" if statistic == "density" else units_of(quantity)
    return Row(*where, method, seed, region, quantity, statistic, *figure, unit)

"""From the files of all simulations to what a sweep has found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scenetruth.design.sweep.jobs import Job, read_measured
from scenetruth.design.sweep.measure import Measured
from scenetruth.design.sweep.plan import Plan
from scenetruth.design.sweep.point_rows import rows_of_point
from scenetruth.design.sweep.result import Sweep
from scenetruth.design.sweep.rows import Row

__all__ = ["gathered"]


def gathered(job: Job, keys: Sequence[str], failed: Mapping[str, str]) -> Sweep:
    """Return what a sweep has found.

    Parameters
    ----------
    job
        The simulations.
    keys
        Their keys, by number.
    failed
        Why some could not be made, by key.
    """
    plan = job.plan
    rows: list[Row] = []
    failures, notes = list(failed.values()), dict[str, None]()
    labels: dict[str, None] = dict.fromkeys(one.label for one in job.contestants)
    grows = False
    for place, point in enumerate(plan.points):
        found: dict[int, tuple[Measured, Path | None]] = {}
        for number in range(place * plan.each, (place + 1) * plan.each):
            key = keys[number]
            if key in failed:
                continue
            measured, path = read_measured(job.path(key)), job.path(key).with_suffix(".npz")
            found[plan.at(number)[1]] = (measured, path if job.keeps else None)
            failures += [f"{job.told(number)}: {label}: {why}" for label, why in measured.failures.items()]
            notes |= dict.fromkeys(measured.notes)
            labels |= dict.fromkeys([*measured.figures, *measured.failures])
            grows |= measured.grows
        rows += rows_of_point(plan.values(point), plan.labels[point.scene], found)
    return Sweep(
        plan.factors,
        plan.labels,
        list(labels),
        rows,
        failures,
        [*notes, *_idle(plan, rows)],
        grows=grows,
        is_grid=plan.is_grid,
        logarithmic=plan.logarithmic,
    )


def _idle(plan: Plan, rows: Sequence[Row]) -> Iterable[str]:
    """Tell which factors have changed no figure at all."""
    if not plan.is_grid:
        return
    for path in plan.factors:
        seen: dict[tuple[Any, ...], set[float]] = {}
        counts: dict[tuple[Any, ...], int] = {}
        for row in rows:
            others = tuple(repr(value) for name, value in row.values.items() if name != path)
            what = (*others, row.scene, row.method, row.seed, row.region, row.quantity, row.statistic)
            seen.setdefault(what, set()).add(row.number)
            counts[what] = counts.get(what, 0) + 1
        compared = [what for what, count in counts.items() if count > 1]
        if compared and all(len(seen[what]) == 1 for what in compared):
            yield f"{path} has changed no figure"

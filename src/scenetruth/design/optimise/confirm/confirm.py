"""The best rigs simulated: figures with intervals, and prediction beside simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from scenetruth.dataset.engine.each import for_each
from scenetruth.dataset.unfit import versions_here
from scenetruth.design.optimise.confirm.compare import compared
from scenetruth.design.optimise.confirm.intervals import interval_at, interval_of
from scenetruth.design.optimise.confirm.lighter import lighter
from scenetruth.design.optimise.confirm.measure import Confirmation, Figures, figure_in, simulate_one
from scenetruth.design.optimise.goal.parts import Confirm
from scenetruth.design.optimise.goal.prepare import Prepared
from scenetruth.design.optimise.parts import Discrepancy, Objective, Rig
from scenetruth.design.optimise.rig.evaluate import parts_of, predicted
from scenetruth.design.optimise.statistics import STATISTICS
from scenetruth.progress import Progress
from scenetruth.scene import scene_from_plain

__all__ = ["Confirmed", "confirmed", "seeds_of"]

_LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Confirmed:
    """What simulations say.

    Parameters
    ----------
    rigs
        The rigs with their figures, by number.
    discrepancies
        Prediction beside simulation.
    changes
        What is different in simulations, in words.
    """

    rigs: Mapping[int, Rig]
    discrepancies: tuple[Discrepancy, ...]
    changes: tuple[str, ...]


def confirmed(
    rigs: Sequence[Rig],
    prepared: Prepared,
    confirm: Confirm,
    folder: Path,
    workers: int,
    *,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Confirmed:
    """Simulate rigs with several seeds, in pieces of work that are done once.

    Parameters
    ----------
    rigs
        The rigs.
    prepared
        What is designed.
    confirm
        How they are simulated.
    folder
        Where figures are kept.
    workers
        Processes; 0 for this one.
    progress
        Called with (what, done, total).
    notice
        Called with lines that a user may want to read.
    """
    if not rigs:
        return Confirmed({}, (), ())
    task = prepared.task
    light = [lighter(scene_from_plain(rig.scene), task.objectives[0].region, confirm.most_px) for rig in rigs]
    job = Confirmation(
        str((folder / "simulations").resolve()),
        tuple(one.plain for one in light),
        seeds_of(prepared.scene.seed, confirm.seeds),
        task.objectives,
        tuple(sorted(versions_here().items())),
    )
    missing = [number for number in range(len(job)) if job.figures(number) is None]
    for_each(
        missing,
        simulate_one,
        (job,),
        present=len(job) - len(missing),
        workers=workers,
        what="simulations",
        progress=progress,
        notice=notice,
    )
    found: dict[int, Rig] = {}
    discrepancies: list[Discrepancy] = []
    for place, rig in enumerate(rigs):
        each = [job.figures(place * confirm.seeds + number) for number in range(confirm.seeds)]
        told = replace(rig, figures=_by_seed(each, task.objectives))
        intervals = {one.title: interval_at(told, one.title, one.statistic) for one in task.objectives}
        found[rig.number] = replace(told, simulated={title: one for title, one in intervals.items() if one.seeds})
        scene = scene_from_plain(light[place].plain)
        prediction = predicted(scene, task.method)
        for objective in task.objectives:
            parts = parts_of(objective, scene, prediction)
            here = sum(value * value for value in parts.values()) ** 0.5
            simulated = found[rig.number].simulated.get(objective.title, interval_of([]))
            discrepancies.append(compared(rig.number, objective, here, simulated))
    changes = tuple(dict.fromkeys(change for one in light for change in one.changes))
    return Confirmed(found, tuple(discrepancies), changes)


def seeds_of(seed: int, count: int) -> tuple[int, ...]:
    """Return the seeds of simulations: those that follow the scene's own."""
    return tuple((seed + 1 + number) % (_LARGEST_SEED + 1) for number in range(count))


def _by_seed(
    each: Sequence[Figures | None], objectives: Sequence[Objective]
) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return all statistics by objective's title, a figure for each seed."""
    told = {
        one.title: {name: tuple(figure_in(figures, one.title, name) for figures in each) for name in STATISTICS}
        for one in objectives
    }
    for title, figures_of in told.items():
        figures_of["density"] = tuple((one or {}).get(title, {}).get("density", math.nan) for one in each)
    return told

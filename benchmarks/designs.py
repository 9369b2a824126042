"""Measure what optimised rigs are worth: against random rigs, against simulations, and with other seeds.

Run it from the top of the repository: ``python -m benchmarks.designs [--random N] [--seeds N] [--folder FOLDER] [SPEC
...]``. For every design specification, the best prediction is held against the best of random rigs that satisfy the
constraints; the order of simulated rigs against that of their predictions, pair by pair over the same seeds; and the
recommended rig is simulated with other seeds than those that its interval was made from: the interval should hold 95 %
of them.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.optimisation import DesignResult, load_design_spec, optimise
from scenetruth.design.optimisation.confirmation import (
    ConfirmationTask,
    get_simulated_statistic,
    reduce_scene,
    simulate_candidate,
)
from scenetruth.design.optimisation.design_result import describe_rank_consistency
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.problem_setup import OptimisationProblem, prepare_problem
from scenetruth.design.optimisation.rig_context import RigContext
from scenetruth.design.optimisation.rig_evaluation import build_rig
from scenetruth.design.prediction import Prediction, PredictionInputs
from scenetruth.errors import SceneError
from scenetruth.jobs.executors import create_executor
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.scene import Scene

DESIGNS = ("leaf_growth", "cube_depth", "sheet_motion")
FOLDER = Path(__file__).parents[1] / "scenes" / "designs"
_MOST_DRAWN, _AT_ONCE, _ABOUT = 500, 500, 0.05


def random_rigs(file: Path, count: int) -> list[Mapping[str, float]]:
    """Return predictions of random rigs that satisfy a design specification's constraints."""
    prepared = prepare_problem(load_design_spec(file))
    generator = np.random.default_rng(2026)
    crew = create_executor(2)
    ledger = EvaluationLog(prepared.task, prepared.space, crew)
    found: list[Mapping[str, float]] = []
    drawn = 0
    try:
        while len(found) < count and drawn < _MOST_DRAWN * count:
            points = generator.random((_AT_ONCE, len(prepared.space))).tolist()
            likely = [point for point in points if _may_hold(prepared, prepared.space.values(point))]
            drawn += len(points)
            found += [one.predicted for one in ledger.ask(likely, "random") if one.holds]
    finally:
        crew.close()
    found = found[:count]
    print(f"  {len(found)} of {drawn:,} random rigs satisfy the constraints", flush=True)
    return found


def _may_hold(prepared: OptimisationProblem, values: Mapping[str, Any]) -> bool:
    """Tell whether a rig satisfies what geometry tells without a prediction; most random rigs do not."""
    base = prepared.task.base
    try:
        built = build_rig(base, values)
        scene = Scene.from_dict(built.plain)
    except SceneError:
        return False
    depth = float(values.get("working_distance_mm", base.depth_mm))
    nothing = dict.fromkeys((field.name for field in fields(PredictionInputs)), math.nan)
    causes: Any = {**nothing, "depth_mm": depth, "frames": scene.frames.count}
    causes["window_sigma_px"] = getattr(scene.estimate.settings, "window_sigma_px", math.nan)
    region = prepared.task.objectives[0].region
    blank = Prediction("analytic", "", (region,), 1.0, {}, {region: PredictionInputs(**causes)})
    facts = RigContext(scene, blank, region, values, built.lens, built.camera, built.stage, built.f_number)
    told = [one for limit in prepared.task.limits for one in limit.checked(facts)]
    # What needs a prediction has no value here; depths in the image differ a little from that of the base scene.
    return all(one.holds or one.margin > -_ABOUT or math.isnan(one.value) for one in told)


def against_random(design: DesignResult, rigs: Sequence[Mapping[str, float]]) -> None:
    """Print the best of the front beside the best of random rigs, and how many of these the front leaves unbeaten."""
    for one in design.objectives:
        best = min(rig.predicted[one.title] for rig in design.front)
        random = min((rig[one.title] for rig in rigs), default=math.nan)
        print(f"  {one.title}: {best:.4g} {one.unit}, best of random rigs {random:.4g} ({random / best:.2f} times)")
    titles = [one.title for one in design.objectives]
    unbeaten = sum(
        not any(all(rig.predicted[title] <= told[title] for title in titles) for rig in design.front) for told in rigs
    )
    print(f"  random rigs that no rig of the front beats in all objectives: {unbeaten} of {len(rigs)}")


def order_kept(design: DesignResult) -> None:
    """Print which pairs of simulated rigs keep the order of their predictions, and of which it cannot be told."""
    for line in describe_rank_consistency(design.objectives, design.orders):
        print(f"  {line}")
    for one in design.orders:
        print(
            f"  {one.objective}: rig {one.worse} over rig {one.better}: predicted {one.predicted:.2f}, simulated "
            f"{one.simulated:.2f} ({one.ci_low:.2f} to {one.ci_high:.2f}, {one.seeds} seeds): {one.verdict}"
        )
    for each in design.discrepancies:
        print(f"  rig {each.rig}: {each.says}")


def other_seeds(design: DesignResult, count: int, max_size_px: int | None, folder: Path) -> None:
    """Print how many recordings with other seeds lie in the intervals of the recommended rig."""
    rig = design.recommended
    light = reduce_scene(Scene.from_dict(rig.scene), design.objectives[0].region, max_size_px)
    first = int(rig.scene["seed"]) + 1000
    seeds = tuple(range(first, first + count))
    versions = tuple(sorted(collect_versions().items()))
    job = ConfirmationTask(str(folder / "simulations"), (light.plain,), seeds, design.objectives, versions)
    missing = [number for number in range(count) if job.figures(number) is None]
    for_each(missing, simulate_candidate, (job,), present=count - len(missing), workers=2, notice=print)
    for one in design.objectives:
        expected = rig.simulated[one.title]
        found = [get_simulated_statistic(job.figures(number), one.title, one.statistic) for number in range(count)]
        inside = sum(expected.pi_low <= figure <= expected.pi_high for figure in found)
        print(
            f"  {one.title}, {one.statistic_title}, {one.unit}, other seeds: "
            f"{', '.join(f'{figure:.4g}' for figure in found)}"
        )
        print(f"  {inside} of {count} within {expected.pi_low:.4g} to {expected.pi_high:.4g}", end="")
        reached = sum(figure <= (one.wanted or 0.0) for figure in found)
        print(f"; {reached} within what is wanted, {one.wanted:g}" if one.wanted is not None else "")


def main() -> None:
    """Print all figures, design by design."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("designs", nargs="*", metavar="SPEC", help=f"of {', '.join(DESIGNS)}; all if not given")
    parser.add_argument("--random", type=int, default=200, help="random rigs")
    parser.add_argument("--seeds", type=int, default=0, help="other seeds for the recommended rig")
    parser.add_argument("--folder", type=Path, help="where designs are kept")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="field of the specification")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for name in given.designs or DESIGNS:
            file = FOLDER / f"{name}.yaml"
            print(name, flush=True)
            folder = (given.folder or Path(scratch)) / name
            design = optimise(file, output=folder, overrides=given.set)
            print(f"  seconds: {dict(design.seconds)}")
            for line in design.summary().splitlines():
                print(f"  {line}")
            against_random(design, random_rigs(file, given.random))
            order_kept(design)
            if given.seeds and design.recommended.is_confirmed:
                other_seeds(design, given.seeds, load_design_spec(file).confirmation.max_size_px, folder)


if __name__ == "__main__":
    main()

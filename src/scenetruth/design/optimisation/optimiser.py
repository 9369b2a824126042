"""Execution of an optimisation: search, sensitivity, Pareto front and confirmation; resumable."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimisation.choice_descents import descend_from_choices
from scenetruth.design.optimisation.confirmation import (
    ConfirmationResult,
    check_rank_consistency,
    find_indistinct,
    simulate_candidates,
)
from scenetruth.design.optimisation.design_records import (
    Discrepancy,
    RigDesign,
    Sensitivity,
    compute_rig_interval,
    decide_rig_target,
)
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.design_search import (
    SensitivityResult,
    SobolIndices,
    allocate_evaluations,
    analyse_sensitivity,
    require_optional_libraries,
    search_with_optuna,
)
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.interpretation import (
    check_rules_of_thumb,
    compute_local_sensitivities,
    list_assumptions,
    refuse_infeasible,
    rig_from_evaluation,
)
from scenetruth.design.optimisation.pareto_front import (
    add_alternatives,
    find_pareto_front,
    select_distinguishable,
    select_recommended,
    thin_front,
)
from scenetruth.design.optimisation.problem_setup import OptimisationProblem, load_problem
from scenetruth.design.optimisation.report.design_report import write_design_files
from scenetruth.design.optimisation.rig_evaluation import Evaluation, build_rig, compute_rig_context, predict_scene
from scenetruth.design.optimisation.specification import DesignSpec, DesignSpecLike, load_design_spec
from scenetruth.design.optimisation.standard_lens import choose_standard_lens
from scenetruth.jobs.executors import TaskExecutor, create_executor, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.results import compute_key
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.progress import Progress, say
from scenetruth.resources import Limits, refuse_beyond_limits
from scenetruth.scene import Overrides, Scene

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["optimise"]

INDEX = "specification.json"
"""File that identifies the directory of a design."""
_FOLDER = JobFolder(INDEX, "a design", "simulations", compared=("key",), indent=None)
_PREDICTIONS = "predictions.jsonl"
_MOST_SHOWN = 24
_MORE_SEEDS = 4


def optimise(
    specification: DesignSpecLike,
    *,
    overrides: Overrides = (),
    seeds: int | None = None,
    limits: Limits | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> DesignResult:
    """Optimise a camera rig under constraints by predicted uncertainty, and confirm the best candidates by simulation.

    Thousands of rigs are evaluated by closed-form predictions: an initial Sobol sequence, descents from all choices of
    lens, camera and stage, a search by Optuna and a sensitivity analysis. The best rigs of the front are simulated,
    estimated and scored with several seeds; the best of them is recommended. Existing results in the output directory
    are reused, and a resumed optimisation gives the same result.

    Parameters
    ----------
    specification
        The design specification, its plain data, its file, or the name of a bundled one.
    overrides
        Changes of the specification, as in `scenetruth.load_scene`.
    seeds
        Number of simulated recordings of each confirmed rig; by default ``confirmation.seeds`` of the specification.
    limits
        Resource limits of every scene that is simulated (`scenetruth.Limits`); the default limits if not given.
    output
        Output directory: the report ``index.html``, ``recommended.yaml``, ``recommended_preview.yaml`` of reduced cost,
        ``pareto_front.csv``, ``evaluations.csv``, ``design.json``. Nothing is written by default.
    workers
        Number of single-threaded processes: 1, the default, uses this process only; -1 uses all processors.
    scheduler
        Address of a Dask scheduler whose workers are used instead; they need the directory under the same path.
    progress
        Called with (label, done, total).

    Returns
    -------
    DesignResult
        The recommended rig, the Pareto front, alternatives and their analysis.

    Raises
    ------
    DesignSpecError
        If the design specification is invalid, or no rig satisfies its constraints; lists all problems.
    ArgumentError
        If the number of workers is invalid, or a scheduler is used without an output directory.
    MachineError
        If Optuna or SALib is not installed.
    OutputExistsError
        If the directory has other contents.

    See Also
    --------
    predict : Predict the uncertainty of one scene.
    sweep : Simulate, estimate and score scenes over the levels of factors.
    scenetruth.design.optimisation.load_design_spec : Load a design specification from a file.

    Examples
    --------
    Three positions in front of a wall, on a stage with 16 mm of travel, without simulations:

    >>> from scenetruth.design.optimisation import optimise
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [4, 16]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    >>> spec = {"title": "A wall", "scene": scene, "variables": {"stage.baseline_mm": {"values": [4, 6, 8, 10]}}}
    >>> spec |= {"constraints": [{"kind": "stage_travel", "max": 16}], "objectives": [{"quantity": "depth"}]}
    >>> spec |= {"search": {"predictions": 16, "morris_trajectories": 0, "sobol": 0}, "confirmation": {"rigs": 0}}
    >>> best = optimise(spec).recommended
    >>> dict(best.parameters), f"depth to {best.predicted['Depth']:.2f} mm"
    ({'stage.baseline_mm': 8}, 'depth to 0.16 mm')
    >>> [f"{one.title}: {one.value:g} {one.unit}, {one.sense} {one.limit:g}" for one in best.constraints]
    ['stage travel: 16 mm, at most 16']
    """
    resolve_workers(workers)
    require_optional_libraries()
    known, prepared = load_problem(specification, overrides=overrides)
    if seeds is not None:
        known = load_design_spec(known, overrides={"confirmation.seeds": seeds})
    refuse_beyond_limits(prepared.scene, limits)
    identity = {"format": 1, "key": _key(prepared), "title": known.title}
    other = "belongs to a design with another scene, other constraints or objectives; use another directory"
    with _FOLDER.open(output, identity, other=other, scheduler=scheduler) as place:
        run = _Run(known, prepared, place, progress, say, limits)
        crew = create_executor(workers, 1, scheduler)
        try:
            run.search(crew)
        finally:
            crew.close()
        design = run.answer(workers, scheduler)
        if output is not None:
            design = replace(design, folder=place)
            with run.timed("page"):
                write_design_files(design, place)
    return design


def _key(prepared: OptimisationProblem) -> str:
    task = prepared.task
    depends = {
        "scene": task.base.plain,
        "places": task.base.places,
        "light": None if task.base.light is None else task.base.light.model_dump(),
        "entries": {kind: {k: v.model_dump() for k, v in task.base.entries.of(kind).items()} for kind in _KINDS},
        "limits": [one.model_dump() for one in task.limits],
        "objectives": [(one.quantity, one.region, one.statistic) for one in task.objectives],
        "method": task.method,
        "versions": collect_versions(),
    }
    return compute_key(depends, default=str)


_KINDS = ("lens", "camera", "stage")


@dataclass
class _Run:
    """State of a running optimisation."""

    spec: DesignSpec
    prepared: OptimisationProblem
    folder: Path
    progress: Progress | None
    say: Callable[[str], None]
    limits: Limits | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    found: list[Evaluation] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    confirmed: bool = False
    effects: SensitivityResult = field(default_factory=lambda: SensitivityResult({}, {}, (0.0, 0.0)))

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[what] = round(self.seconds.get(what, 0.0) + time.perf_counter() - start, 2)

    def search(self, crew: TaskExecutor) -> None:
        from scipy.stats import qmc

        space, objectives, search = self.prepared.space, self.prepared.task.objectives, self.spec.search
        shares = allocate_evaluations(search, len(space))
        file = self.folder / _PREDICTIONS
        ledger = EvaluationLog(self.prepared.task, space, crew, file, self.progress, search.predictions)
        try:
            with self.timed("first rigs"):
                points = qmc.Sobol(len(space), seed=np.random.default_rng(search.seed)).random(shares.even)
                ledger.ask(points.tolist(), "even design")
            with self.timed("search"):
                self.confirmed = descend_from_choices(ledger, space, objectives, shares.descents, search.seed)
                left = shares.even + shares.descents - len(ledger)
                search_with_optuna(ledger, space, objectives, shares.search + left, search.seed)
                refuse_infeasible(self.spec, ledger.evaluations)
            with self.timed("sensitivity"):
                self.effects = analyse_sensitivity(ledger, space, objectives, shares.morris, shares.sobol, search.seed)
        finally:
            ledger.close()
        self.found, self.phases = ledger.evaluations, ledger.phases

    def answer(self, workers: int, scheduler: str | None) -> DesignResult:
        """Simulate the best rigs, and return the result."""
        space, task = self.prepared.space, self.prepared.task
        front = find_pareto_front(self.found, task.objectives)
        first = select_recommended([self.found[number].predicted for number in front], task.objectives)
        front = [front[place] for place in thin_front(self._logs(front), _MOST_SHOWN, first)]
        shown = add_alternatives(self.found, task.objectives, space, front)
        rigs = [rig_from_evaluation(number, self.found[number], self.prepared) for number in shown]
        confirm = self.spec.confirmation
        chosen = [rigs[place] for place in select_distinguishable(self._logs(shown), len(front), confirm.rigs)]
        with self.timed("simulations"):
            simulated = simulate_candidates(
                chosen,
                self.prepared,
                confirm,
                self.folder,
                workers,
                scheduler=scheduler,
                progress=self.progress,
                notice=self.say,
                limits=self.limits,
            )
        by_number = {rig.number: simulated.rigs.get(rig.number, rig) for rig in rigs}
        recommended = self._recommended(list(by_number.values()), simulated)
        with self.timed("simulations"):
            recommended, discrepancies = self._decide(recommended, simulated.discrepancies, workers, scheduler)
        by_number[recommended.number] = recommended
        on_front = [by_number[number] for number in front]
        on_front.sort(key=lambda rig: [rig.predicted[one.title] for one in task.objectives])
        one = self.found[recommended.number]
        scene = Scene.from_dict(recommended.scene)
        facts = compute_rig_context(
            task, build_rig(task.base, one.values), scene, predict_scene(scene, task.method), one.values
        )
        assert facts is not None
        with self.timed("changes by 10 %"):
            sensitivities = self._sensitivities(one)
        return DesignResult(
            specification=self.spec.model_dump(mode="json", by_alias=True),
            title=self.spec.title,
            objectives=task.objectives,
            recommended=recommended,
            front=tuple(on_front),
            screened=self._screened(),
            sensitivities=sensitivities,
            rules=check_rules_of_thumb(facts),
            assumptions=list_assumptions(
                self.spec, facts, simulated.changes, self.effects.left_out, sensitivities, confirmed=self.confirmed
            ),
            discrepancies=discrepancies,
            seconds=self.seconds,
            alternatives=tuple(by_number[number] for number in shown if number not in front),
            orders=check_rank_consistency(list(by_number.values()), task.objectives),
            standard_lens=choose_standard_lens(task, one.values),
        )

    def _logs(self, numbers: Sequence[int]) -> NDArray[np.float64]:
        """Return logarithms of predictions, shape (rigs, objectives)."""
        titles = [one.title for one in self.prepared.task.objectives]
        return np.log([[self.found[number].predicted[title] for title in titles] for number in numbers])

    def _recommended(self, rigs: list[RigDesign], simulated: ConfirmationResult) -> RigDesign:
        """Return the best simulated rig, of those that seeds do not distinguish the one with the smallest RMSE.

        Without valid simulations, return the best predicted rig.
        """
        objectives = self.prepared.task.objectives
        values = [rig for rig in rigs if all(one.title in rig.simulated for one in objectives)]
        if values:
            figures = [{one.title: rig.simulated[one.title].value for one in objectives} for rig in values]
            best = values[select_recommended(figures, objectives)]
            # Seeds do not distinguish these: the rig with fewer outliers is recommended.
            like = find_indistinct(best, values, objectives)
            errors = [
                {one.title: compute_rig_interval(rig, one.title, "rmse").value for one in objectives} for rig in like
            ]
            if all(math.isfinite(value) for each in errors for value in each.values()):
                return like[select_recommended(errors, objectives)]
            return best
        if simulated.rigs:
            self.say("no simulation has valid values of all objectives; the recommended rig is based on predictions")
        return rigs[select_recommended([rig.predicted for rig in rigs], objectives)]

    def _decide(
        self, rig: RigDesign, discrepancies: tuple[Discrepancy, ...], workers: int, scheduler: str | None
    ) -> tuple[RigDesign, tuple[Discrepancy, ...]]:
        """Simulate a rig with more seeds while these do not decide whether it reaches a target."""
        confirm = self.spec.confirmation
        seeds, most = confirm.seeds, confirm.most_seeds or _MORE_SEEDS * confirm.seeds
        while seeds < most and (undecided := self._undecided(rig)):
            seeds = min(2 * seeds, most)
            self.say(f"{', '.join(undecided)}: undecided whether the target is reached; {seeds} seeds")
            more = simulate_candidates(
                [rig],
                self.prepared,
                confirm.model_copy(update={"seeds": seeds}),
                self.folder,
                workers,
                scheduler=scheduler,
                progress=self.progress,
                notice=self.say,
                limits=self.limits,
            )
            rig = more.rigs[rig.number]
            discrepancies = (*(one for one in discrepancies if one.rig != rig.number), *more.discrepancies)
        return rig, discrepancies

    def _undecided(self, rig: RigDesign) -> list[str]:
        """Return the titles of the objectives whose recordings do not decide about the target."""
        decisions = {one.title: decide_rig_target(rig, one) for one in self.prepared.task.objectives}
        return [title for title, one in decisions.items() if one is not None and one.answer == "undecided"]

    def _sensitivities(self, one: Evaluation) -> tuple[Sensitivity, ...]:
        space, task = self.prepared.space, self.prepared.task
        more = compute_local_sensitivities(one, self.prepared)
        less = compute_local_sensitivities(one, self.prepared, 0.9)
        nothing, no_indices = (math.nan, math.nan), SobolIndices(math.nan, math.nan, math.nan, math.nan, 0)
        found = []
        for objective in task.objectives:
            for name in space.names:
                key = (objective.title, name)
                mean, scatter = self.effects.morris.get(key, nothing)
                sobol = self.effects.sobol.get(key, no_indices)
                values = Sensitivity(
                    name,
                    objective.title,
                    mean,
                    scatter,
                    sobol.first,
                    sobol.total,
                    more.get(key, math.nan),
                    less.get(key, math.nan),
                    sobol.first_half,
                    sobol.total_half,
                    sobol.samples,
                )
                found.append(values)
        return tuple(found)

    def _screened(self) -> pd.DataFrame:
        import pandas as pd

        rows = [
            {
                **one.values,
                **one.predicted,
                "holds": one.holds,
                "excess": one.excess,
                "phase": phase,
                "problem": one.problem,
            }
            for one, phase in zip(self.found, self.phases, strict=True)
        ]
        return pd.DataFrame(rows)

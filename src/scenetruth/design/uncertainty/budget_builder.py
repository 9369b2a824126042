"""Uncertainty budget of a scene: every source predicted separately, and the largest sources simulated."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from scenetruth.design.uncertainty.contributions import (
    BudgetTable,
    Figures,
    aggregate_runs,
    compute_contributions,
    compute_explained_fraction,
    predict_contributions,
    predict_for_seeds,
)
from scenetruth.design.uncertainty.observation_model import Mask, ObservationModel, build_observation_model
from scenetruth.design.uncertainty.propagation import MODELLED, Propagation, select_propagation
from scenetruth.design.uncertainty.simulation_runs import (
    BudgetTask,
    ErrorMaps,
    SimulationRun,
    perform_run,
    read_run,
    select_optical_sources,
    simulate_run,
    suppress_warnings,
)
from scenetruth.design.uncertainty.source import (
    CalibrationLike,
    UncertaintySource,
    active_sources,
    all_sources,
    contrast_sources,
    resolve_calibration,
)
from scenetruth.design.uncertainty.uncertainty_budget import Budget
from scenetruth.errors import ArgumentError, EstimateError, Problem, SceneError
from scenetruth.estimators.method_specs import MethodLike, offered_methods, read_method
from scenetruth.jobs.executors import resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.output import check_writable, write_atomically
from scenetruth.plain_data import parse_json, seed_problems
from scenetruth.progress import Progress, say
from scenetruth.resources import Limits, load_checked_scene, refuse_beyond_limits
from scenetruth.scene import Overrides, Scene, SceneLike
from scenetruth.scoring.regions import further_regions, main_regions
from scenetruth.simulation import make_truth

__all__ = ["budget"]

INDEX = "budget.json"
"""File that identifies the folder of a budget."""
_FOLDER = JobFolder(INDEX, "a budget", "runs")


def budget(
    scene: SceneLike,
    *,
    method: MethodLike | None = None,
    calibration: CalibrationLike = "typical",
    simulated_share: float = 0.9,
    overrides: Overrides = (),
    region: str = "interior",
    seeds: int | Sequence[int] = 4,
    limits: Limits | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Budget:
    """Compute the uncertainty budget of depth, motion and growth for a scene and a method.

    The contribution of a source is the change of the estimate, pixel by pixel, when this source alone is switched on.
    Errors with ideal images (slanted and curved surfaces, depth discontinuities, method bias) are counted once. All
    contributions are predicted by propagation. The largest are also simulated, until they make up the fraction
    ``simulated_share`` of the sum of squares, and so is the scene with all sources. Existing results are reused.

    Parameters
    ----------
    scene
        The scene with all its imperfections: a scene, its values, its file, or the name of a bundled scene.
    method
        Name of a method, or `scenetruth.estimators.MethodSpec` with its settings; default: the method of the scene.
        Functions and method objects are supported in this process only.
    calibration
        Standard deviations of focal length, principal point and baseline as given to the method: ``"typical"``,
        ``"perfect"``, a `Calibration`, or a mapping of its fields.
    simulated_share
        Fraction of the sum of squares to simulate; 1 for all sources, 0 only for those that cannot be predicted.
    overrides
        Changes to the scene, as in `scenetruth.load_scene`.
    region
        Region of the page and the figure: ``"all"``, ``"interior"``, or ``"object_NAME"``. The table and the returned
        budget contain all regions.
    seeds
        Number of seeds, or a list of seeds: of stage errors, sensor noise, calibration errors, and random textures. By
        default, the first is the seed of the scene.
    limits
        Limits on the scene (`scenetruth.Limits`); default: the standard limits.
    output
        Output folder for runs, table and figures; default: none.
    workers
        Number of local processes with one thread each; 1 uses this process only, -1 all processors.
    scheduler
        Address of a Dask scheduler to use instead. Its workers must have access to the folder by the same path.
    progress
        Callback with arguments (what, done, total).

    Returns
    -------
    Budget
        Contributions and combined uncertainties.

    Raises
    ------
    SceneError
        If the scene is invalid, or has several rows of cameras.
    EstimateError
        If the method does not exist, or gives no estimate for ideal images.
    ArgumentError
        If an argument is invalid, including the number of workers, or a scheduler is used without a folder.
    OutputExistsError
        If the folder contains the budget of another scene, or other data.

    See Also
    --------
    predict : Predicts the uncertainty by noise alone.
    sweep : Errors as a function of scene fields.
    scenetruth.design.uncertainty.Calibration : Uncertainty of the calibration.

    Examples
    --------
    A stage with a yaw of 20 µrad, and a focal length with an uncertainty of 0.1 %; only predicted:

    >>> from scenetruth.design.uncertainty import budget
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"frames": {"count": 3}, "render": {"backend": "raycast"}, "score": {"interior_margin_px": 0}}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2.2, "errors": {"yaw_urad": 20}}}
    >>> scene |= {"sensor": {"noise_std": 0.002, "bit_depth": 12}}
    >>> known = {"focal_length_percent": 0.1}
    >>> found = budget(scene, method="structure_tensor", calibration=known, seeds=1, simulated_share=0)
    >>> for part in found.contributions("depth")[:3]:
    ...     print(f"{part.title}, {part.size}: {part.value:.2f} {part.unit}")
    stage yaw, 20 µrad: 1.61 mm
    focal length, 0.1 %: 0.50 mm
    sensor noise, 0.2 % of full scale: 0.12 mm
    """
    resolve_workers(workers)
    whole, problems = load_checked_scene(scene, overrides=overrides, limits=limits or Limits()), []
    whole.require_grey("an uncertainty budget")
    numbers = [whole.seed + k for k in range(seeds)] if isinstance(seeds, int) and 1 <= seeds <= _MAX_SEEDS else []
    if not isinstance(seeds, int):
        numbers = [seed for seed in seeds if isinstance(seed, int) and seed >= 0]
    problems += seed_problems(seeds, _MAX_SEEDS)
    if not 0 <= simulated_share <= 1:
        problems.append(Problem("simulated_share", "must be a fraction from 0 to 1", simulated_share))
    regions = ["all", "interior", *(f"object_{item.name}" for _, item in whole.parts)]
    if region not in regions:
        problems.append(Problem("region", f"must be one of {', '.join(regions)}", region))
    try:
        known = resolve_calibration(calibration)
    except ArgumentError as error:
        problems += error.problems
    if problems:
        raise ArgumentError(problems, source="an uncertainty budget")
    if whole.stage.rows > 1:
        message = "must be 1: a budget supports one row of positions"
        raise SceneError([Problem("stage.rows", message, whole.stage.rows)])
    if whole.stage.poses is not None or whole.stage.axis_tilt_urad is not None:
        field = "poses" if whole.stage.poses is not None else "axis_tilt_urad"
        message = "must be null: a budget draws the errors of the stage from stage.errors; omit the field"
        raise SceneError([Problem(f"stage.{field}", message)])
    own = [] if method is None else [read_method(method)]
    refuse_beyond_limits(whole, limits)
    if output is not None and not Path(output).exists():
        check_writable(output)
    _require_region(whole, region, limits)
    chosen = own[0].choice(whole.estimate) if own else whole.estimate
    whole = whole.model_copy(update={"estimate": chosen})
    causes = active_sources(whole, known)
    identity = {"format": 2, "scene": whole.to_dict(), "calibration": known.model_dump()}
    other = "contains the budget of another scene, method or calibration; choose another"
    with (
        offered_methods(own),
        _FOLDER.open(output, identity, other=other, scheduler=scheduler) as place,
    ):
        job = BudgetTask(
            str((place / "runs").resolve()),
            json.dumps(whole.to_dict()),
            chosen.method,
            json.dumps(chosen.settings.model_dump(mode="json")),
            known,
            (),
            tuple(sorted(collect_versions().items())),
        )
        options = {"workers": workers, "scheduler": scheduler, "progress": progress, "notice": say}
        work = _Work(job, causes, numbers, options)
        parts, totals = compute_contributions(work.done(simulated_share))
        values = Budget(
            scene=whole.description,
            method=chosen.method,
            draws=len(numbers),
            remedies=_mitigations(whole, work.known, causes),
            failures=work.failures,
            folder=None if output is None else place,
            parts=parts,
            totals=totals,
        )
        if output is not None:
            _write(values, place, region)
    return values


def _require_region(scene: Scene, region: str, limits: Limits | None) -> None:
    """Raise an error if a region of the reference image is empty, before the simulations."""
    if region == "all":
        return
    one = scene.model_copy(update={"frames": scene.frames.model_copy(update={"count": 1})})
    with suppress_warnings():
        truth = make_truth(one, limits=limits)
    camera, margin = scene.camera, scene.score.interior_margin_px
    masks = main_regions(truth, margin)
    masks |= further_regions(truth, masks["interior"], scene.score)
    if region in masks and masks[region].any():
        return
    if region != "interior":
        shown = ["all", *(name for name in masks if name.startswith(("interior", "object_")) and masks[name].any())]
        message = f"has no pixel in the reference image, or is the only object; must be one of {', '.join(shown)}"
        raise ArgumentError([Problem("region", message, region)], source="an uncertainty budget")
    message = (
        f"no pixel of the image of {camera.width} x {camera.height} px is so far from silhouettes and creases: the "
        "region interior is empty; reduce the margin, or use the region all"
    )
    raise SceneError([Problem("score.interior_margin_px", message, margin)])


_MAX_SEEDS = 1000


class _Work:
    """Computation of one budget."""

    def __init__(
        self,
        job: BudgetTask,
        causes: Sequence[UncertaintySource],
        seeds: list[int],
        options: dict[str, Any],
    ) -> None:
        self.job, self.causes, self.known = job, causes, job.calibration
        self.scene = job.scene
        self.seeds = seeds
        self.contrast = tuple(sorted(contrast_sources(causes)))
        self.everything = tuple(sorted(one.kind for one in causes))
        self._options = options
        self.failures: list[str] = []
        self._kept: dict[SimulationRun, ErrorMaps] = {}

    def done(self, confirm: float) -> BudgetTable:
        """Simulate, predict and combine the contributions."""
        base = [(), *([self.contrast] if self.contrast else []), *([self.everything] if self.everything else [])]
        self._simulate(list(dict.fromkeys(base)))
        if self._read((), self.seeds[0]) is None:
            raise EstimateError([Problem("scene", line) for line in self.failures], source="ideal images of the scene")
        modelled = self.scene.estimate.method in MODELLED and len(self.scene.stage.s) > 1
        figures = self._predicted() if modelled else {}
        gathered = aggregate_runs(self._read, self.seeds, self.scene, self.known, figures)
        names = self._worth(gathered, confirm) if modelled else [one.kind for one in self.causes]
        sets = {kind: self._beside(kind) for kind in names}
        self._simulate([*dict.fromkeys(sets.values())])
        drawn = self._drawn(names) if modelled else {}
        shares = self._remembered("explained", self._explain) if modelled else {}
        return replace(gathered, sets=sets, drawn=drawn, everything=self.everything, explained=shares)

    def _beside(self, kind: str) -> tuple[str, ...]:
        """Return the sources switched on for a source: for some, those that change the contrast stay on."""
        beside = self.contrast if all_sources()[kind].on_contrast else ()
        return tuple(sorted({kind, *beside}))

    def _simulate(self, sets: Sequence[tuple[str, ...]]) -> None:
        runs = tuple(SimulationRun(kinds, seed, draw) for draw, seed in enumerate(self.seeds) for kinds in sets)
        # Runs with the same rendered images are consecutive; the ideal images of the first seed are needed next.
        runs = tuple(sorted(runs, key=lambda run: (run.draw, select_optical_sources(run.kinds)), reverse=True))
        job = replace(self.job, runs=runs)
        missing = [number for number, run in enumerate(runs) if not job.path(run).exists()]
        done = for_each(
            missing,
            perform_run,
            (job,),
            present=len(runs) - len(missing),
            what="runs",
            **self._options,
        )
        self.failures += [line for line in done.failed.values() if line not in self.failures]

    def _read(self, kinds: tuple[str, ...], seed: int) -> Any:
        run = SimulationRun(kinds, seed, seed - self.seeds[0])
        if run not in self._kept:
            if not self.job.path(run).exists():
                return None
            self._kept[run] = read_run(self.job, run)
        return self._kept[run]

    @cached_property
    def _seen(self) -> tuple[ObservationModel, Propagation | None, dict[str, Mask]]:
        """The observation model of the scene, the propagation model of the method, and the regions."""
        run = SimulationRun(self.contrast, self.seeds[0], 0)
        maps = self._read(run.kinds, run.seed)
        if maps is None:
            values = [Problem("scene", line) for line in self.failures]
            raise EstimateError(values, source="images of the scene with its lens and lighting")
        with suppress_warnings():
            recording, truth = simulate_run(self.job, run)
            sight = build_observation_model(self.scene, recording, truth, maps.known)
            regions = {name: mask & maps.known for name, mask in maps.regions.items()}
            return sight, select_propagation(sight, self.scene.estimate.settings), regions

    def _predicted(self) -> dict[str, Figures]:
        surfaces = [one for one in all_sources().values() if one.of_surface]
        found = {}
        for number, one in enumerate((*self.causes, *surfaces)):
            self._tell("predicted", number, len(self.causes) + len(surfaces))
            found[one.kind] = self._remembered(f"{one.kind}", partial(self._predict, one))
        self._tell("predicted", len(found), len(found))
        return found

    def _predict(self, cause: UncertaintySource) -> Figures:
        sight, propagation, regions = self._seen
        assert propagation is not None  # called for modelled methods only
        with suppress_warnings():
            return predict_contributions(cause, sight, propagation, self.known, regions)

    def _explain(self) -> Figures:
        sight, propagation, regions = self._seen
        left = self._read((), self.seeds[0])
        assert propagation is not None
        assert left is not None  # checked before
        with suppress_warnings():
            return compute_explained_fraction(sight, propagation, left, regions)

    def _drawn(self, names: Sequence[str]) -> dict[str, Figures]:
        return {
            kind: self._remembered(
                f"{kind}, {len(self.seeds)} draws", partial(self._predict_drawn, all_sources()[kind])
            )
            for kind in names
        }

    def _predict_drawn(self, cause: UncertaintySource) -> Figures:
        sight, propagation, regions = self._seen
        assert propagation is not None
        with suppress_warnings():
            return predict_for_seeds(cause, sight, propagation, self.known, regions, self.seeds)

    def _remembered(self, name: str, make: Callable[[], Figures]) -> Figures:
        """Return figures from a cache file, or compute and write them."""
        path = self.job.path(SimulationRun(self.everything, self.seeds[0], 0)).with_suffix("")
        path = path.parent / "predicted" / path.name / f"{name}.json"
        try:
            return {(quantity, region): value for quantity, region, value in parse_json(path.read_bytes())}
        except (OSError, ValueError, TypeError):
            pass
        found = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path, overwrite=True) as partial_:
            partial_.write_text(json.dumps([[*key, value] for key, value in found.items()]), encoding="utf-8")
        return found

    def _tell(self, what: str, done: int, total: int) -> None:
        if self._options["progress"] is not None:
            self._options["progress"](what, done, total)

    def _worth(self, gathered: BudgetTable, confirm: float) -> list[str]:
        """Return the sources to simulate."""
        wanted = {one.kind for one in self.causes if one.coarse and confirm > 0}
        for quantity, region in gathered.places:
            squares = {one.kind: gathered.predicted_square(one.kind, quantity, region) for one in self.causes}
            wanted |= {kind for kind, square in squares.items() if not math.isfinite(square)}
            known = {kind: square for kind, square in squares.items() if math.isfinite(square)}
            sure = gathered.ideal_square(quantity, region)  # errors with ideal images are already simulated
            total = sure + sum(known.values())
            for kind, square in sorted(known.items(), key=lambda pair: -pair[1]):
                if sure >= confirm * total:
                    break
                wanted.add(kind)
                sure += square
        return [one.kind for one in self.causes if one.kind in wanted]


def _mitigations(scene: Scene, calibration: Any, causes: Sequence[UncertaintySource]) -> dict[str, Any]:
    surfaces = [one for one in all_sources().values() if one.of_surface]
    found = {one.kind: one.remedy(scene, calibration) for one in (*causes, *surfaces)}
    return {kind: remedy for kind, remedy in found.items() if remedy is not None}


def _write(found: Budget, folder: Path, region: str) -> None:
    from scenetruth.design.uncertainty.budget_report import write_page, write_waterfall

    with write_atomically(folder / "budget.csv", overwrite=True) as partial_:
        found.to_dataframe().to_csv(partial_, index=False)
    write_waterfall(found, folder / "waterfall.png", region)
    write_page(found, folder, region)

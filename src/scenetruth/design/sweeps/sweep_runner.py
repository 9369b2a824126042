"""Execution of a sweep: validation, simulation by workers, result and report; resumable."""

from __future__ import annotations

import json
import shlex
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenetruth.design.sweeps.aggregation import collect_result
from scenetruth.design.sweeps.factors import format_level
from scenetruth.design.sweeps.point_simulation import BOUND, SweepTask, methods_from_scene, run_sweep_task
from scenetruth.design.sweeps.sweep_plan import SweepPlan, build_plan
from scenetruth.design.sweeps.sweep_result import Sweep
from scenetruth.errors import ArgumentError, CollectedErrors, EstimateError, Problem, SceneError
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, read_methods
from scenetruth.jobs.executors import describe_pickling_error, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.output import write_atomically
from scenetruth.progress import Progress, say
from scenetruth.resources import Limits
from scenetruth.scene import Overrides, Scene, SceneLike
from scenetruth.scene.field_paths import assign

__all__ = ["sweep"]


_MOST_LISTED = 20


def refuse_methods(contestants: Sequence[MethodSpec], workers: int, scheduler: str | None = None) -> None:
    """Reject methods with the label of a bound, and methods that cannot be sent to other processes."""
    problems = []
    for one in contestants:
        if one.label.split(" ")[0] == BOUND:
            problems.append(Problem("methods", "is reserved for the Cramér-Rao bound; use another label", one.label))
        if why := describe_pickling_error(one, workers, scheduler):
            message = f"cannot be sent to another process ({why}); specify 'module:function' or workers=1"
            problems.append(Problem("methods", message, one.label))
    if problems:
        raise EstimateError(problems)


def assign_backends(plan: SweepPlan) -> SweepPlan:
    """Return the plan with an explicit rendering backend in every scene, so that all processes use the same."""
    from scenetruth.render import choose_renderer
    from scenetruth.scene.built_scene import build_scene

    plains = []
    for number, plain in enumerate(plan.plains):
        own = [place for places in plan.places[number] for place in places]
        if plain["render"]["backend"] == "auto" and not any(f"{place}.".startswith("render.") for place in own):
            changed = json.loads(json.dumps(plain))
            scenes = [plan.scene(place * plan.each) for place, point in enumerate(plan.points) if point.scene == number]
            with choose_renderer(scenes[0], build_scene(scenes[0], painted=False)).renderer as renderer:
                name = renderer.name
            if name == "raycast" or any(scene.needs_rays for scene in scenes):
                assign(changed, "render.backend", "raycast")
            else:
                assign(changed, "render.backend", "pyrender")
                assign(changed, "render.platform", name.partition("(")[2].rstrip(")") or "auto")
            plain = changed
        plains.append(plain)
    return replace(plan, plains=tuple(plains))


def refuse_impossible_points(job: SweepTask, numbers: Sequence[int], progress: Progress | None) -> None:
    """Reject points with a scene that exceeds a limit, shows no object, or does not suit a method."""
    from scenetruth.estimators import find_method, requirements, validate_settings
    from scenetruth.provenance import blank_recording
    from scenetruth.resources import build_checked_scene, refuse_beyond_limits

    plan, problems = job.plan, dict[tuple[str, str], Problem]()
    points = sorted({number - number % plan.each for number in numbers})
    for done, number in enumerate(points):
        if progress is not None:
            progress("checks", done, len(points))
        scene = plan.scene(number)
        where = job.label(number).rpartition(", seed")[0]
        wrong: list[Problem] = []
        try:
            refuse_beyond_limits(scene, job.limits)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                build_checked_scene(scene, painted=False)
        except SceneError as error:
            wrong += error.problems
        blank = blank_recording(scene)
        for one in job.contestants or methods_from_scene(scene):
            method = find_method(one.method)
            wrong += requirements(blank, method, validate_settings(method, one.settings))
        for problem in wrong:
            entries = Problem(problem.path, f"{problem.message}; at {where}", problem.value)
            problems.setdefault((problem.path, problem.message), entries)
        if len(problems) >= _MOST_LISTED:
            break
    if progress is not None and points:
        progress("checks", len(points), len(points))
    if problems:
        raise ArgumentError(list(problems.values()), source="a sweep")


INDEX = "sweep.json"
"""File that identifies the directory of a sweep."""
_FOLDER = JobFolder(INDEX, "a sweep", "points", compared=(), indent=None)


def sweep(
    scenes: SceneLike | Sequence[SceneLike],
    vary: Mapping[str, Any],
    *,
    methods: Iterable[MethodLike] | MethodLike | None = None,
    overrides: Overrides = (),
    sobol_points: int = 0,
    seeds: int | Sequence[int] = 3,
    limits: Limits | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Simulate, estimate and score scenes over the levels of factors.

    Every combination of levels is a design point, and is simulated with every seed of textures, noise and stage
    errors. The seeds are the same at every point, so that differences between points are due to the factors. Existing
    results in the output directory are reused; additional levels, points or seeds are added.

    Parameters
    ----------
    scenes
        One or several scenes, plain data or files.
    vary
        Levels by path of a field; ``*`` stands for all list entries. Levels are a list, or a text as on the command
        line: ``"1,2,5"``; ``"1..10:4"``, four levels; ``"1..10:4log"``, on a logarithmic scale; ``"1..10"`` or
        ``"1..10:log"``, sampled by Sobol points.
    methods
        As in `scenetruth.compare`; default: the method of each scene.
    overrides
        Changes of the scenes at every point, as in `scenetruth.load_scene`: ``"camera.width=320"``.
    sobol_points
        Number of Sobol points of the ranges without a number of levels.
    seeds
        Number of seeds, starting with the seed of the scene; or a list of seeds.
    limits
        Resource limits of a scene; default: those of `Limits`.
    output
        Output directory: the report ``index.html``, ``results.csv``, ``plots/``, and a file for
        each simulation. Nothing is written by default.
    workers
        Number of single-threaded processes: 1, the default, uses this process only; -1 uses all processors.
    scheduler
        Address of a Dask scheduler whose workers are used instead; they need the directory under the same path.
    progress
        Called with (label, done, total).

    Returns
    -------
    Sweep
        All records.

    Raises
    ------
    ArgumentError
        If factors are invalid (unknown path, no effect, levels that give no valid scene; all problems are listed), the
        number of workers is invalid, or a scheduler is used without an output directory.
    SceneError
        If a scene is invalid.
    EstimateError
        If a method is unknown, a setting is invalid, or a function cannot be sent to another process.
    OutputExistsError
        If the directory has other contents.

    See Also
    --------
    compare : Run methods on the benchmark suite.

    Examples
    --------
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2}, "frames": {"count": 3}, "render": {"backend": "raycast"}}
    >>> scene |= {"sensor": {"noise_std": 0.01}, "score": {"interior_margin_px": 0}}
    >>> found = sweep(scene, {"stage.baseline_mm": [2, 4]}, methods="structure_tensor", seeds=2)
    >>> found.best("depth").values
    {'stage.baseline_mm': 4}
    """
    contestants: list[MethodSpec] = []
    errors = CollectedErrors()
    with errors.collect():
        contestants = [] if methods is None else read_methods(methods)
    with errors.collect():
        plan = build_plan(scenes, vary, seeds, sobol_points, overrides=overrides, own_methods=methods is None)
    with errors.collect():
        resolve_workers(workers)
        refuse_methods(contestants, workers, scheduler)
    errors.raise_all()
    with _FOLDER.open(output, {"format": 1}, scheduler=scheduler) as place:
        plan = assign_backends(plan)
        versions = tuple(sorted(collect_versions().items()))
        job = SweepTask(str((place / "points").resolve()), plan, tuple(contestants), versions, limits)
        keys = [job.key(number) for number in range(len(plan))]
        # Different levels may give the same scene.
        missing = {key: number for number, key in reversed(list(enumerate(keys))) if not job.is_done(key)}
        refuse_impossible_points(job, sorted(missing.values()), progress)
        _announce(job, len(missing), sum(key not in missing for key in keys))
        done = for_each(
            sorted(missing.values()),
            run_sweep_task,
            (job,),
            present=len(keys) - len(missing),
            workers=workers,
            scheduler=scheduler,
            what="simulations",
            progress=progress,
            notice=say,
        )
        found = collect_result(job, keys, {keys[number]: why for number, why in done.failed.items()})
        if output is not None:
            found = replace(found, folder=place)
            _write(found, job, _command(scenes, vary, seeds, sobol_points, overrides, contestants))
    return found


def _announce(job: SweepTask, missing: int, kept: int) -> None:
    plan = job.plan
    seeds = f"{plan.each} seed{'s' if plan.each > 1 else ''}"
    text = f"{len(plan.points):,} points with {seeds}: {len(plan):,} simulations, {missing:,} of them to run"
    say(text + (f", {kept:,} results reused" if kept else ""))


def _write(found: Sweep, job: SweepTask, again: str) -> None:
    from scenetruth.design.sweeps.static_plots import write_static_plots
    from scenetruth.design.sweeps.sweep_report import write_sweep_report

    assert found.folder is not None
    frame = found.to_dataframe()
    with write_atomically(found.folder / "results.csv", overwrite=True) as partial:
        frame.to_csv(partial, index=False)
    methods = [one.spelled for one in job.contestants]
    entries = {"format": 1, "factors": found.factors, "scenes": found.scenes, "methods": methods, "command": again}
    with write_atomically(found.folder / INDEX, overwrite=True) as partial:
        partial.write_text(json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    write_static_plots(found, found.folder / "plots")
    write_sweep_report(found, found.folder, again)


def _command(
    scenes: Any, vary: Mapping[str, Any], seeds: Any, sobol: int, overrides: Overrides, contestants: Any
) -> str:
    """Return the command that repeats the sweep; an empty text if scenes or methods are not files and names."""
    files = [scenes] if isinstance(scenes, str | Path) else scenes
    if isinstance(files, Mapping | Scene) or not all(isinstance(file, str | Path) for file in files):
        return ""
    if not all(isinstance(one.method, str) for one in contestants):
        return ""
    words = ["scenetruth", "design", "sweep", *map(_from_here, files)]
    for path, values in vary.items():
        words += ["--vary", f"{path}={values if isinstance(values, str) else ','.join(map(format_level, values))}"]
    for one in contestants:
        words += ["--method", one.spelled]
    changes = (
        [f"{path}={json.dumps(value)}" for path, value in overrides.items()]
        if isinstance(overrides, Mapping)
        else overrides
    )
    for override in changes:
        words += ["--set", override]
    words += ["--seeds", str(seeds) if isinstance(seeds, int) else ",".join(map(str, seeds))]
    words += ["--sobol-points", str(sobol)] if sobol else []
    return shlex.join([*words, "-o", "again"])


def _from_here(file: str | Path) -> str:
    """Return a path relative to the working directory if the file is in it."""
    path = Path(file)
    return str(path.relative_to(Path.cwd()) if path.is_absolute() and path.is_relative_to(Path.cwd()) else path)

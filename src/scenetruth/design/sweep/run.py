"""Makes a sweep: simulations, estimates and scores over what varies; it can be interrupted, and run again."""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenetruth.comparison.contestants import Given as GivenMethod
from scenetruth.comparison.contestants import contestants_of
from scenetruth.dataset.engine.each import for_each
from scenetruth.dataset.unfit import versions_here
from scenetruth.design.sweep.checking import refuse_methods, refuse_unmakeable, with_backends
from scenetruth.design.sweep.factors import label_of
from scenetruth.design.sweep.gathering import gathered
from scenetruth.design.sweep.jobs import Job, measure_one
from scenetruth.design.sweep.planning import Given, plan_of
from scenetruth.design.sweep.result import Sweep
from scenetruth.errors import OutputExistsError
from scenetruth.placing import hold, sweep_inside, write_aside
from scenetruth.progress import Progress
from scenetruth.resources import Limits
from scenetruth.scene import Scene

__all__ = ["INDEX", "sweep"]

INDEX = "sweep.json"
"""What a folder of a sweep is known by."""


def sweep(
    scenes: Given | Sequence[Given],
    vary: Mapping[str, Any],
    methods: Iterable[GivenMethod] | GivenMethod | None = None,
    folder: str | Path | None = None,
    *,
    seeds: int | Sequence[int] = 3,
    sobol: int = 0,
    overrides: Sequence[str] = (),
    workers: int = 0,
    limits: Limits | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Sweep:
    """Simulate, estimate and score scenes over what varies.

    Every combination of values is a point. A point is simulated with every seed, of textures, noise and errors of the
    stage; seeds are the same at every point, so that differences between points are due to what varies. What is done
    stays in the folder, and is not done again: with more values, points or seeds, only these are made.

    Parameters
    ----------
    scenes
        One or several: scenes, plain values, or files.
    vary
        What varies: values by path of a field, with ``*`` for every one. Values are a list, or a text as on the command
        line: ``"1,2,5"``; ``"1..10:4"``, four values; ``"1..10:4log"``, on a logarithmic scale; ``"1..10"`` or
        ``"1..10:log"``, filled by Sobol's points.
    methods
        As of `scenetruth.compare`; every scene's own method if not given.
    folder
        Where figures are kept: the page ``index.html``, ``results.parquet``, ``results.csv``, ``plots/``, and a file
        for each simulation. If not given, nothing is kept.
    seeds
        How many, the scene's own seed being the first; or a list of them.
    sobol
        How many points fill the ranges that have no number of values.
    overrides
        Changes of the scenes that hold at every point, as of `scenetruth.load_scene`: ``"camera.width=320"``.
    workers
        Processes of this machine, of one thread each; 0 does all in this one.
    limits
        Bounds of what a scene may ask for; those by default if not given.
    progress
        Called with (what, done, total).
    notice
        Called with lines that a user may want to read.

    Returns
    -------
    Sweep
        All figures.

    Raises
    ------
    RecipeError
        If what varies cannot be: paths that lead nowhere or vary nothing, values that make no scene. Lists all.
    SceneError
        If a scene is none.
    EstimateError
        If there is no such method, a setting is impossible, or a function cannot be sent to another process.
    OutputExistsError
        If the folder holds something else.

    See Also
    --------
    compare : Methods over the cases of the metrology suite.

    Examples
    --------
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2}, "frames": {"count": 3}, "render": {"backend": "raycast"}}
    >>> scene |= {"sensor": {"noise_std": 0.01}, "score": {"interior_margin_px": 0}}
    >>> found = sweep(scene, {"stage.baseline_mm": [2, 4]}, "structure_tensor", seeds=2)
    >>> found.best("depth").values
    {'stage.baseline_mm': 4}
    """
    contestants = [] if methods is None else contestants_of(methods)
    plan = plan_of(scenes, vary, seeds, sobol, overrides=overrides, own_methods=not contestants)
    refuse_methods(contestants, workers)
    with ExitStack() as stack:
        if folder is None:
            place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="scenetruth-")))
        else:
            place = Path(folder)
            _begin(place)
            stack.enter_context(hold(place / "run"))
            sweep_inside(place / "points")
        plan = with_backends(plan)
        versions = tuple(sorted(versions_here().items()))
        job = Job(str((place / "points").resolve()), plan, tuple(contestants), versions, limits)
        keys = [job.key(number) for number in range(len(plan))]
        # Different values may make the same scene.
        missing = {key: number for number, key in reversed(list(enumerate(keys))) if not job.is_done(key)}
        refuse_unmakeable(job, sorted(missing.values()), progress)
        _announce(job, len(missing), sum(key not in missing for key in keys), notice)
        done = for_each(
            sorted(missing.values()),
            measure_one,
            (job,),
            present=len(keys) - len(missing),
            workers=workers,
            what="simulations",
            progress=progress,
            notice=notice,
        )
        found = gathered(job, keys, {keys[number]: why for number, why in done.failed.items()})
        if folder is not None:
            found = replace(found, folder=place)
            _write(found, job, _command(scenes, vary, seeds, sobol, overrides, contestants))
    return found


def _begin(folder: Path) -> None:
    """Claim a folder for sweeps."""
    index = folder / INDEX
    if index.exists():
        return
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise OutputExistsError(folder, "exists, and is no folder of a sweep; choose another")
    (folder / "points").mkdir(parents=True, exist_ok=True)
    with write_aside(index) as aside:
        aside.write_text(json.dumps({"format": 1}) + "\n", encoding="utf-8")


def _announce(job: Job, missing: int, kept: int, notice: Callable[[str], None] | None) -> None:
    plan = job.plan
    if notice is not None:
        seeds = f"{plan.each} seed{'s' if plan.each > 1 else ''}"
        told = f"{len(plan.points):,} points with {seeds}: {len(plan):,} simulations, {missing:,} of them to be made"
        notice(told + (f", {kept:,} kept from earlier" if kept else ""))


def _write(found: Sweep, job: Job, again: str) -> None:
    from scenetruth.design.sweep.page.pictures import write_pictures
    from scenetruth.design.sweep.page.write import write_page

    assert found.folder is not None
    frame = found.to_frame()
    with write_aside(found.folder / "results.parquet", overwrite=True) as aside:
        frame.to_parquet(aside)
    with write_aside(found.folder / "results.csv", overwrite=True) as aside:
        frame.to_csv(aside, index=False)
    methods = [one.spelled for one in job.contestants]
    told = {"format": 1, "factors": found.factors, "scenes": found.scenes, "methods": methods, "command": again}
    with write_aside(found.folder / INDEX, overwrite=True) as aside:
        aside.write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    write_pictures(found, found.folder / "plots")
    write_page(found, found.folder, again)


def _command(
    scenes: Any, vary: Mapping[str, Any], seeds: Any, sobol: int, overrides: Sequence[str], contestants: Any
) -> str:
    """Return the command that makes the sweep again; an empty text if scenes or methods are not files and names."""
    files = [scenes] if isinstance(scenes, str | Path) else scenes
    if isinstance(files, Mapping | Scene) or not all(isinstance(file, str | Path) for file in files):
        return ""
    if not all(isinstance(one.method, str) for one in contestants):
        return ""
    words = ["scenetruth", "design", "sweep", *map(str, files)]
    for path, values in vary.items():
        words += ["--vary", f"{path}={values if isinstance(values, str) else ','.join(map(label_of, values))}"]
    for one in contestants:
        words += ["--method", one.spelled]
    for override in overrides:
        words += ["--set", override]
    words += ["--seeds", str(seeds) if isinstance(seeds, int) else ",".join(map(str, seeds))]
    words += ["--sobol", str(sobol)] if sobol else []
    return shlex.join([*words, "-o", "again"])

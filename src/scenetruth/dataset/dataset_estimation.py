"""Estimation and scoring of all samples of a data set by one method."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scenetruth.dataset.catalogue import flatten_score, require_parquet, score_file, write_scores
from scenetruth.dataset.checksums import dump_record, list_path, write_checksums
from scenetruth.dataset.fingerprint import open_sampler, read_fingerprint
from scenetruth.dataset.generation import DatasetRunResult
from scenetruth.dataset.layout import DatasetFolder, compute_shard_number, extract_sample
from scenetruth.dataset.samples import SampleStore
from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators import MethodChoice, choose
from scenetruth.estimators.code_fingerprint import compute_code_fingerprint
from scenetruth.estimators.method_specs import MethodSpec, read_method
from scenetruth.jobs.executors import resolve_workers
from scenetruth.jobs.results import TaskResult, perform_task
from scenetruth.jobs.scheduler import for_each
from scenetruth.output import write_atomically
from scenetruth.pipeline import PipelineRunner, RunDirectory, run_problems
from scenetruth.progress import Progress, say
from scenetruth.resources import Limits
from scenetruth.scoring import Score

__all__ = ["estimate_dataset"]


def estimate_dataset(
    dataset: str | Path,
    method: str | MethodSpec | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
    numbers: Sequence[int] | None = None,
    retries: int = 0,
    threads: int = 1,
    scheduler: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> DatasetRunResult:
    """Estimate samples of a data set by a method, and score them.

    Estimates and scores are stored in the directories of the samples; for samples in tar files, only the scores are
    stored. The catalogue gains the columns ``score.METHOD.REGION.QUANTITY.STATISTIC``. Existing scores are reused,
    unless the code of a user-defined method has changed: then all of its scores are removed first.

    Parameters
    ----------
    dataset
        Directory of the data set.
    method
        Name of the method, or a `scenetruth.estimators.MethodSpec` that names one; by default that of the recipe.
    settings
        Settings of the method that differ from those of the recipe.
    numbers
        Numbers of the samples; by default all.
    retries
        How often a failed sample is tried again.
    threads
        Threads of each worker.
    scheduler
        Address of a Dask scheduler, whose workers are used instead.
    workers
        Processes: 1, the default, for this process, -1 for all processors.
    progress
        Called with (what, done, total).

    Returns
    -------
    DatasetRunResult
        ``made`` and ``present``: numbers of new and of existing scores; ``failed``: numbers of the failed samples.

    Raises
    ------
    EstimateError
        If the method is unknown, a setting is invalid, or the settings differ from those of existing scores.
    StoreError
        If the data set is damaged.

    See Also
    --------
    run_dataset : Generates the data set.
    open_dataset : Reads its samples.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> recipe = {"name": "walls", "base": plain, "samples": 2, "licence": "CC-BY-4.0"}
    >>> with TemporaryDirectory() as folder:
    ...     made = st.run_dataset(recipe, output=f"{folder}/walls")
    ...     result = st.estimate_dataset(f"{folder}/walls", "plane_sweep")
    >>> result.made, result.present, result.failed
    (2, 0, [])
    """
    require_parquet()
    resolve_workers(workers)
    places = DatasetFolder(dataset)
    identity, sampler = read_fingerprint(places), open_sampler(places)
    own = sampler.bases[0].estimate
    chosen = _choice(own, method, settings or {})
    problems = run_problems(sampler.bases[0], [chosen])
    if problems:
        raise EstimateError(problems)
    store = SampleStore.of(places, sampler, identity)
    there = store.present(range(identity.count))
    store.refuse_empty(there)
    wanted = sorted(there if numbers is None else there.intersection(numbers))
    code = compute_code_fingerprint(chosen.method)
    _remove_scores_of_other_code(places, chosen.method, code)
    _refuse_other_settings(places, chosen)
    missing = [number for number in wanted if not score_file(places, chosen.method, number).exists()]
    arguments = (str(places.path.resolve()), chosen.model_dump_json(), sampler.recipe.samples_per_shard, bool(code))
    found = for_each(
        missing,
        try_estimate,
        arguments,
        present=len(wanted) - len(missing),
        workers=workers,
        threads=threads,
        scheduler=scheduler,
        retries=retries,
        what="estimate",
        progress=progress,
        notice=say,
    )
    write_scores(places, chosen.method)
    return DatasetRunResult(places, found.done, found.present, sorted(found.failed))


def _choice(own: MethodChoice, method: str | MethodSpec | None, settings: Mapping[str, Any]) -> MethodChoice:
    spec = read_method(own.method if method is None else method)
    if not isinstance(spec.method, str):
        message = "must be named: samples may be estimated by different processes"
        raise EstimateError([Problem("method", message, spec.label)])
    return MethodSpec(spec.method, {**spec.settings, **settings}).choice(own)


def _remove_scores_of_other_code(places: DatasetFolder, method: str, code: str) -> None:
    """Remove the scores of a user-defined method whose code has changed."""
    folder = places.scores(method)
    file = folder / "made_of.txt"
    if not code or (file.exists() and file.read_text(encoding="utf-8").strip() == code):
        return
    scores = sorted(folder.glob("*/*.json"))
    if scores:
        changed = "has changed" if file.exists() else "may have changed"
        say(f"the code of '{method}' {changed}: {len(scores):,} scores of the former code are recomputed")
    # The marker is written last, so that an interrupted removal is completed by the next run.
    table = places.scores_table(method)
    for one in (table, list_path(table), folder / "settings.json", *scores):
        one.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    with write_atomically(file, overwrite=True) as partial:
        partial.write_text(code + "\n", encoding="utf-8")


def _refuse_other_settings(places: DatasetFolder, chosen: MethodChoice) -> None:
    file = places.scores(chosen.method) / "settings.json"
    text = json.dumps(chosen.settings.model_dump(mode="json"), sort_keys=True, indent=1) + "\n"
    if file.exists():
        if file.read_text(encoding="utf-8") != text:
            message = f"has scores with other settings in {file.parent}; remove that directory to estimate again"
            raise EstimateError([Problem("settings", message)])
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(file) as partial:
        partial.write_text(text, encoding="utf-8")


def try_estimate(folder: str, choice: str, per_shard: int, anew: bool, number: int) -> TaskResult:
    """Estimate and score a sample in a worker; ``anew`` ignores estimates of other code. Exceptions are returned."""
    places, given = DatasetFolder(folder), json.loads(choice)
    chosen = choose({"method": given["method"], **{key: value for key, value in given.items() if key != "method"}})
    shard = places.shard(compute_shard_number(number, per_shard))

    def work() -> dict[str, Any]:
        start = time.perf_counter()
        if shard.exists():
            with extract_sample(shard, number) as files:
                score = _scored(files, chosen, anew)
        else:
            sample = places.sample(number)
            score = _scored(sample, chosen, anew)
            own = RunDirectory(sample).paths(chosen.method)
            write_checksums(list_path(own.score_json), [own.score_json, own.score_csv])
        target = score_file(places, chosen.method, number)
        target.parent.mkdir(parents=True, exist_ok=True)
        row = {"sample": number, "seconds": time.perf_counter() - start, **flatten_score(score)}
        with write_atomically(target, overwrite=True) as partial:
            partial.write_text(dump_record(row, None), encoding="utf-8")
        return row

    return perform_task(number, work)


def _scored(folder: Path, chosen: MethodChoice, anew: bool) -> Score:
    from scenetruth.scoring import score_settings

    with PipelineRunner(RunDirectory(folder), overwrite=True, limits=Limits()) as runner:
        files = runner.folder.paths(chosen.method)
        if anew or not files.estimate.exists():
            runner.estimate(chosen)
        scene = json.loads(runner.recording.attrs["scene"])
        runner.score(chosen.method, score_settings(**scene.get("score", {})))
        return runner.scores[chosen.method]

"""Generation of a data set from its recipe, and its status."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.dataset.catalogue import CatalogueWriter, list_catalogued, merge_parts, require_parquet
from scenetruth.dataset.checksums import dump_record, load_record
from scenetruth.dataset.fingerprint import DatasetFingerprint, begin_dataset, open_sampler, read_fingerprint
from scenetruth.dataset.layout import DatasetFolder, claim_sample
from scenetruth.dataset.recipe_loader import RecipeLike, load_recipe
from scenetruth.dataset.recipe_validation import DrawReport, refuse_recipe, try_draws
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import Partition, SampleStore, build_sample_scene, try_sample
from scenetruth.errors import OutputExistsError
from scenetruth.jobs.executors import create_executor, resolve_workers
from scenetruth.jobs.results import TaskResult
from scenetruth.jobs.scheduler import ResourceGuard, TaskScheduler, write_with_retry
from scenetruth.output import check_writable, lock_output, remove_leftovers, write_atomically
from scenetruth.progress import Progress, say
from scenetruth.resources import (
    Forecast,
    Limits,
    compute_workload,
    estimate_cost,
    inspect_machine,
    limited_objects,
    refuse_resources,
)
from scenetruth.scene import Overrides

__all__ = [
    "DatasetRunResult",
    "DatasetStatus",
    "RecipeReport",
    "check_recipe",
    "estimate_sample_cost",
    "read_status",
    "run_dataset",
]


@dataclass
class DatasetRunResult:
    """Result of `run_dataset` or `estimate_dataset`.

    Parameters
    ----------
    folder
        Directory of the data set.
    made
        Number of new samples, or of new scores.
    present
        Number of existing results that were reused.
    failed
        Numbers of the failed samples.

    See Also
    --------
    scenetruth.run_dataset, scenetruth.estimate_dataset : Return it.

    Examples
    --------
    >>> from scenetruth.dataset import DatasetRunResult
    >>> from scenetruth.dataset.layout import DatasetFolder
    >>> result = DatasetRunResult(DatasetFolder("outputs/leaves"), made=98, present=900, failed=[17, 512])
    >>> f"{result.made} of {result.made + len(result.failed)} new samples"
    '98 of 100 new samples'
    """

    folder: DatasetFolder
    made: int = 0
    present: int = 0
    failed: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class DatasetStatus:
    """Progress of a data set: counts of all and of existing samples, and error messages by number of the sample."""

    count: int
    done: int
    failed: dict[int, str]

    @property
    def missing(self) -> int:
        """Number of missing samples."""
        return self.count - self.done


def run_dataset(
    recipe: RecipeLike | None,
    *,
    output: str | Path,
    overrides: Overrides = (),
    partition: Partition | None = None,
    retries: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    max_tasks_per_worker: int = 500,
    extend: bool = False,
    limits: Limits | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> DatasetRunResult:
    """Generate the missing samples of a data set.

    Samples are written atomically and existing samples are kept: an interrupted run resumes when it is repeated.

    Parameters
    ----------
    recipe
        The recipe, its values, its file, or the name of a bundled recipe; None to use the recipe in the directory.
    output
        Directory of the data set.
    overrides
        Changed fields of the recipe, as for `load_scene`.
    partition
        Partition to generate, for several machines that share the directory; default: all samples.
    retries
        Number of retries of a failed sample.
    threads
        Threads per worker process.
    scheduler
        Address of a Dask scheduler, used instead of local processes. Its workers must reach the directory by
        the same path.
    max_tasks_per_worker
        Number of samples after which a worker process is replaced.
    extend
        Whether the sample count may exceed that of an existing data set.
    limits
        Resource limits of a sample; the default limits if not given.
    workers
        Processes on this machine: 1, the default, for this process only, -1 for all processors.
    progress
        Called with (what, done, total).

    Returns
    -------
    Outcome
        Numbers of generated and of failed samples; the errors are in the files of ``failed/``.

    Raises
    ------
    RecipeError
        If the ranges or the first draws yield no valid sample; raised before any work.
    MachineError
        If a sample exceeds the resources of the machine; raised before any work.
    ArgumentError
        If the number of workers is invalid.
    MismatchError
        If the directory contains a data set of another recipe, or of files that have changed since.
    OutputExistsError
        If the output is a file, or another run generates this partition.

    See Also
    --------
    load_recipe : Load a recipe from a file.
    open_dataset : Read a data set.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> far = {"objects.0.pose.position_mm.2": {"kind": "uniform", "low": 90, "high": 110}}
    >>> recipe = st.Recipe.from_dict({"name": "walls", "base": plain, "samples": 2, "distributions": far})
    >>> with TemporaryDirectory() as folder:
    ...     outcome = st.run_dataset(recipe, output=f"{folder}/walls")
    ...     dataset = st.open_dataset(f"{folder}/walls")
    ...     print(outcome.made, dataset[1].truth.depth.sizes)
    2 Frozen({'t': 1, 'y': 25, 'x': 30})
    """
    require_parquet()
    resolve_workers(workers)
    places, whole = DatasetFolder(output), partition or Partition()
    if places.path.exists() and not places.path.is_dir():
        raise OutputExistsError(places.path, "is not a directory; specify another output")
    check_writable(places.path)
    # Processes are started by their first task.
    with closing(create_executor(workers, threads, scheduler)) as crew:
        if recipe is None:
            read_fingerprint(places)
            sampler = open_sampler(places)
        else:
            sampler = load_recipe(recipe, overrides=overrides).sampler()
            refuse_recipe(sampler, crew)
        identity = begin_dataset(places, sampler, extend=extend)
        forecast = estimate_sample_cost(sampler, identity, limits or Limits(), places.path)
        outcome = DatasetRunResult(places)
        with lock_output(places.path / f"run-{whole.label}"):
            for group in places.groups_with_leftovers():
                remove_leftovers(group, claim_sample)
            store = SampleStore.of(places, sampler, identity)
            numbers = store.numbers(whole)
            done = store.present(numbers)
            outcome.present = len(done)
            writer = CatalogueWriter(places, sampler, whole.label)
            _catalogue_missing(store, writer, done)
            store.pack(numbers)
            if dashboard := getattr(crew, "dashboard", ""):
                say(f"dashboard: {dashboard}")
            work = _Work(places, store, writer, outcome, len(numbers), progress, say)
            room = ResourceGuard(places.path, 2 * crew.count * forecast.disk_wanted_bytes, forecast.memory_bytes)
            try:
                drive = TaskScheduler(
                    crew,
                    try_sample,
                    (str(places.path.resolve()), sampler.known),
                    work.made,
                    work.failed,
                    say,
                    room,
                    retries,
                    max_tasks_per_worker,
                )
                work.tell()
                drive.run(number for number in numbers if number not in done)
                crew.renew()
                write_with_retry(writer.flush, "the catalogue", say)
            finally:
                crew.close()
                for group in places.groups_with_leftovers():
                    remove_leftovers(group, claim_sample)
                writer.flush_if_there_is_room()
            if len(store.present(range(identity.count))) == identity.count:
                write_with_retry(lambda: merge_parts(places, sampler), "the catalogue", say)
        return outcome


def estimate_sample_cost(
    sampler: Sampler, identity: DatasetFingerprint | None, limits: Limits, folder: Path
) -> Forecast:
    """Return the resources of one sample; raise if they exceed those of the machine."""
    draw = sampler.draw(0)
    scene = draw.scene() if identity is None else build_sample_scene(sampler, identity, draw)
    truth = sampler.recipe.truth
    demand = compute_workload(
        scene,
        limited_objects(scene, limits),
        views=scene.stage.positions * scene.stage.rows if truth.views == "all" else 1,
        complete=truth.content != "standard",
        save_radiance=sampler.recipe.save_radiance,
    )
    forecast = estimate_cost(demand, ["render"])
    refuse_resources(forecast, inspect_machine(folder), limits)
    return forecast


@dataclass(frozen=True)
class RecipeReport:
    """Result of the validation of a recipe.

    Parameters
    ----------
    draws
        Draws that were tried: ``accepted``, ``drawn``, the ``reasons`` of rejections, and ``problems``.
    resources
        Predicted memory, disk space and processor time of one sample.

    See Also
    --------
    scenetruth.dataset.check_recipe : Returns it.

    Examples
    --------
    >>> from scenetruth.dataset import check_recipe
    >>> report = check_recipe("cubes", samples=4)
    >>> report.draws.accepted, report.draws.problems
    (4, ())
    """

    draws: DrawReport
    resources: Forecast


def check_recipe(
    recipe: RecipeLike,
    *,
    overrides: Overrides = (),
    samples: int = 100,
    limits: Limits | None = None,
    workers: int = 1,
) -> RecipeReport:
    """Validate a recipe, draw samples, and predict the resources of one sample.

    Parameters
    ----------
    recipe
        The recipe, its values, its file, or the name of a bundled recipe.
    overrides
        Changed fields, as for `scenetruth.load_scene`.
    samples
        Number of samples to draw.
    limits
        Resource limits of each scene (`scenetruth.Limits`); the default limits if not given.
    workers
        Processes that draw samples: 1, the default, for this process, -1 for all processors.

    Returns
    -------
    RecipeReport
        The draws and the resources; samples that cannot be drawn are in ``draws.problems``.

    Raises
    ------
    RecipeError
        If the recipe is invalid; lists all problems.
    MachineError
        If a sample needs more than the machine or the limits allow.

    See Also
    --------
    preview_dataset : Shows samples.
    run_dataset : Generates the data set.

    Examples
    --------
    >>> from scenetruth.dataset import check_recipe
    >>> report = check_recipe("cubes", samples=2)
    >>> report.draws.accepted, report.resources.disk_bytes > 0
    (2, True)
    """
    sampler = load_recipe(recipe, overrides=overrides).sampler()
    refuse_recipe(sampler)
    draws = try_draws(sampler, samples, workers=workers)
    return RecipeReport(draws, estimate_sample_cost(sampler, None, limits or Limits(), Path()))


def read_status(folder: str | Path) -> DatasetStatus:
    """Return the progress of the data set in a directory."""
    places = DatasetFolder(folder)
    identity = read_fingerprint(places)
    done = SampleStore.of(places, open_sampler(places), identity).present(range(identity.count))
    failed = {number: _message(places.failure(number)) for number in places.failures() if number not in done}
    return DatasetStatus(identity.count, len(done), failed)


def _message(path: Path) -> str:
    try:
        found = load_record(path.read_bytes())
        return str(found["message"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"cannot be read: {error}"


def _catalogue_missing(store: SampleStore, writer: CatalogueWriter, done: set[int]) -> None:
    for row in store.rows(done - list_catalogued(store.folder)):
        writer.add(row)
    writer.flush()


@dataclass
class _Work:
    """Collect results of workers; a sample is recorded before its directory is removed."""

    places: DatasetFolder
    store: SampleStore
    writer: CatalogueWriter
    outcome: DatasetRunResult
    total: int
    progress: Progress | None
    say: Callable[[str], None]

    def made(self, found: TaskResult) -> None:
        self.writer.add({**found.values, "seconds": found.seconds})
        self.places.failure(found.number).unlink(missing_ok=True)
        self.outcome.made += 1
        write_with_retry(lambda: self.store.added(found.number), "a tar file", self.say)
        self.tell()

    def failed(self, found: TaskResult, attempts: int) -> None:
        failure: dict[str, Any] = {**found.failure, "attempts": attempts}
        failure.setdefault("again", f"scenetruth dataset sample {self.places.recipe} {found.number} -o sample")
        write_with_retry(lambda: self._write_failure(found.number, failure), "what went wrong", self.say)
        self.outcome.failed.append(found.number)
        lines = str(failure["message"]).splitlines()
        self.say(f"sample {found.number} failed: {lines[0] if len(lines) == 1 else ' '.join(lines[:3])}")
        self.tell()

    def _write_failure(self, number: int, failure: Mapping[str, Any]) -> None:
        self.places.failed.mkdir(exist_ok=True)
        with write_atomically(self.places.failure(number), overwrite=True) as partial:
            partial.write_text(dump_record(failure), encoding="utf-8")

    def tell(self) -> None:
        if self.progress is not None:
            done = self.outcome.made + self.outcome.present + len(self.outcome.failed)
            self.progress("samples", done, self.total)

"""The suite: evaluation of methods on all cases, or export of its recordings for external programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from scenetruth.benchmark.benchmark_report import describe_method, write_benchmark_report
from scenetruth.benchmark.benchmark_result import BenchmarkResult
from scenetruth.benchmark.benchmark_tasks import BenchmarkTask, list_design_points, measure_point, read_point_result
from scenetruth.benchmark.cases.case import SUITES, BenchmarkRecord, Case, all_cases, select_cases
from scenetruth.benchmark.design_point import list_realisations, read_error_maps, simulate_point
from scenetruth.benchmark.error_statistics import compute_efficiency_records
from scenetruth.errors import ArgumentError, CollectedErrors, EstimateError, Problem
from scenetruth.estimators.external import recording_key, write_recording
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, read_methods
from scenetruth.jobs.executors import describe_pickling_error, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.output import write_atomically
from scenetruth.plain_data import seed_problems
from scenetruth.progress import Progress, say
from scenetruth.resources import Limits, refuse_beyond_limits

__all__ = ["compare", "select_available_cases", "write_recordings"]


INDEX = "comparison.json"
"""File that identifies the directory of a comparison."""
_FOLDER = JobFolder(INDEX, "a comparison", "points")
_MAX_SEEDS = 1000
_NOT_CHECKED = (
    "not checked for changes: data files, installed packages and services of user-defined methods; "
    "--fresh (fresh=True) measures all scenes again"
)


def compare(
    methods: Iterable[MethodLike] | MethodLike,
    *,
    suite: str = "core",
    cases: Sequence[str] | None = None,
    levels: Sequence[float | str] | None = None,
    seeds: int | Sequence[int] | None = None,
    limits: Limits | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> BenchmarkResult:
    """Run methods on the benchmark suite and return their error statistics.

    Every case varies one factor: noise, contrast, wavelength, slope, disparity, motion, the distance from a
    discontinuity, and more. All methods use the same images. Existing results in the output directory are reused;
    failed results are repeated, and those of user-defined methods if their code has changed.

    Parameters
    ----------
    methods
        One or several: names, ``"module:function"``, methods or functions, or `scenetruth.estimators.MethodSpec` with
        settings and a label.
    suite
        ``"core"`` for routine use, or ``"full"`` for all levels and more noise realisations.
    cases
        Keys of the cases to run; default: all.
    levels
        Levels to run, for a single case: numbers, or names such as those of scenes; default: all of the suite.
    seeds
        Number of realisations of the noise at each level, or their seeds; by default those of the case and the suite.
    limits
        Resource limits of each scene (`scenetruth.Limits`); the default limits if not given.
    output
        Output directory: the page ``index.html``, ``results.csv``, ``summary.csv``, and a file
        for each scene. Default: no output.
    workers
        Number of single-threaded local processes; 1 runs in this process (default), -1 uses all processors.
    scheduler
        Address of a Dask scheduler, whose workers are used instead. They require access to the output directory under
        the same path.
    fresh
        Measure all scenes again instead of reusing results: required after a change that is not detected, which is
        one of data files, installed packages or services that a user-defined method uses.
    progress
        Called with (what, done, total).

    Returns
    -------
    BenchmarkResult
        All results.

    Raises
    ------
    ArgumentError
        If the suite, a case, a level or the number of workers is invalid, a case lacks a requirement, or a scheduler
        is given without an output directory.
    EstimateError
        If a method is unknown, a setting is invalid, or a function cannot be sent to another process.
    ArgumentError
        If the suite, a case or a level is unknown, a case lacks an optional dependency, or seeds are invalid.
    SceneError
        If a scene exceeds a limit.
    OutputExistsError
        If the directory holds a comparison of other methods, or other files.

    See Also
    --------
    score : Score one estimate against one truth.

    Examples
    --------
    >>> import scenetruth as st
    >>> found = st.compare("structure_tensor", cases=["noise"], levels=[0.005])
    >>> row = found.value("flow_x", case="noise", method="structure_tensor")
    >>> bool(row.ci_low < row.value < row.ci_high), row.unit
    (True, 'px/frame')
    """
    contestants: list[MethodSpec] = []
    errors = CollectedErrors()
    with errors.collect():
        contestants = read_methods(methods)
    with errors.collect():
        chosen = select_available_cases(suite, cases, levels)
    with errors.collect():
        if seeds is not None and (wrong := seed_problems(seeds, _MAX_SEEDS)):
            raise ArgumentError(wrong)
    with errors.collect():
        resolve_workers(workers)
        _refuse_what_cannot_travel(contestants, workers, scheduler)
    errors.raise_all()
    numbers = range(seeds) if isinstance(seeds, int) else seeds
    identity = {"format": 1, "suite": suite, "methods": [one.spelled for one in contestants]}
    with _FOLDER.open(output, identity, other=_describe_other, scheduler=scheduler) as place:
        points = list_design_points(chosen, suite, levels, numbers)
        for point in points:
            refuse_beyond_limits(point.scene(), limits)
        job = BenchmarkTask(
            str((place / "points").resolve()),
            tuple(points),
            tuple(contestants),
            tuple(sorted(collect_versions().items())),
            limits,
        )
        missing = [number for number in range(len(points)) if fresh or not job.is_done(number)]
        if len(missing) < len(points):
            kept = len(points) - len(missing)
            say(f"reused: {kept} of {len(points)} scenes; {len(missing)} remaining")
            if any(one.fingerprint for one in contestants):
                say(_NOT_CHECKED)
        done = for_each(
            missing,
            measure_point,
            (job,),
            present=len(points) - len(missing),
            workers=workers,
            scheduler=scheduler,
            what="scenes",
            progress=progress,
            notice=say,
        )
        rows: list[BenchmarkRecord] = []
        failures = list(done.failed.values())
        convention_mismatches: Counter[str] = Counter()
        for number, point in enumerate(points):
            if number in done.failed:
                continue
            measured = read_point_result(job.path(number))
            rows += measured.rows
            failures += [f"{point.case} at {point.name}: {label}: {why}" for label, why in measured.failures.items()]
            convention_mismatches.update(
                f"{label}: {entries}"
                for label, found_here in measured.convention_mismatches.items()
                for entries in found_here
            )
        for case in chosen:
            rows += list(case.conclusions([row for row in rows if row.case == case.kind]))
        rows += list(compute_efficiency_records(rows))
        found = BenchmarkResult(
            [one.label for one in contestants],
            chosen,
            rows,
            failures,
            None if output is None else place,
            [one.label for one in contestants if one.is_own],
            [
                f"{entries} (at {count} of {len(points)} scenes)"
                for entries, count in convention_mismatches.most_common()
            ],
        )
        if output is not None:
            _write_tables(found, place)
            maps = {
                (point.case, value): one
                for number, point in enumerate(points)
                if (one := read_error_maps(job.path(number).with_suffix(".npz"))) is not None
                for value in point.values
            }
            described = {one.label: describe_method(one) for one in contestants}
            write_benchmark_report(found, [one.words for one in contestants], place, suite, maps, described)
    return found


def select_available_cases(
    suite: str,
    cases: Sequence[str] | None,
    values: Sequence[float | str] | None,
) -> list[Case]:
    """Return the specified cases, or all cases of a suite that can be run here."""
    problems = []
    if suite not in SUITES:
        problems.append(Problem("suite", f"must be one of {', '.join(SUITES)}", suite))
    if values is not None and (cases is None or len(cases) != 1):
        problems.append(Problem("levels", "require a single case: specify it", list(values)))
    chosen: list[Case] = []
    try:
        chosen = select_cases(cases)
    except ArgumentError as error:
        problems += error.problems
        chosen = select_cases([name for name in cases or () if name in all_cases()])
    named = cases is not None
    if named and suite in SUITES:
        known = values if len(chosen) == 1 else None
        problems += [problem for case in chosen for problem in _unfit(case, suite, known)]
    if problems:
        raise ArgumentError(problems)
    if not named:
        for case in chosen:
            if case.lacks() and suite == "full":
                say(f"case {case.kind} is skipped: it {case.lacks()}")
    return chosen if named else [case for case in chosen if case.values(suite) and not case.lacks()]


def _unfit(case: Case, suite: str, values: Sequence[float | str] | None) -> Iterable[Problem]:
    """Yield the problems of a specified case and its levels."""
    if case.lacks():
        yield Problem("cases", case.lacks(), case.kind)
    elif values is None:
        if not case.values(suite):
            yield Problem(
                "cases", f"has no levels in the suite {suite}; select the suite full, or specify levels", case.kind
            )
    else:
        for value in values:
            try:
                case.parse_level(value)
            except ArgumentError as error:
                yield from error.problems


def _refuse_what_cannot_travel(contestants: Sequence[MethodSpec], workers: int, scheduler: str | None) -> None:
    problems = []
    for one in contestants:
        if why := describe_pickling_error(one, workers, scheduler):
            message = f"cannot be sent to another process ({why}); specify 'module:function', or workers=1"
            problems.append(Problem("methods", message, one.label))
    if problems:
        raise EstimateError(problems)


def _describe_other(there: Any) -> str:
    held = f"suite {there.get('suite')} of {there.get('methods')}" if isinstance(there, dict) else "other content"
    return f"holds another comparison: {held}; choose another directory"


def _write_tables(found: BenchmarkResult, folder: Path) -> None:
    frame = found.to_dataframe()
    with write_atomically(folder / "results.csv", overwrite=True) as partial:
        frame.to_csv(partial, index=False)
    with write_atomically(folder / "summary.csv", overwrite=True) as partial:
        found.ranking().to_csv(partial)


def write_recordings(
    folder: str | Path,
    suite: str = "core",
    *,
    cases: Sequence[str] | None = None,
    levels: Sequence[float | str] | None = None,
    images: Literal["png", "tiff", "npy"] = "png",
    progress: Progress | None = None,
) -> list[Path]:
    """Write all recordings of a suite, each into a directory named by its key.

    Existing recordings are not written again. The results of a program are expected in directories of the same names
    (see `scenetruth.estimators.external.ResultsFolder`).
    """
    if Path(folder).is_file():
        raise EstimateError([Problem("recordings", "must be a directory", folder)])
    points = list_design_points(select_available_cases(suite, cases, levels), suite, levels)
    written = []
    for done, point in enumerate(points):
        if progress is not None:
            progress("recordings", done, len(points))
        case = all_cases()[point.case]
        ideal, _ = simulate_point(case, point)
        for _, recording in list_realisations(case, point, ideal):
            place = Path(folder) / recording_key(recording)
            if not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                write_recording(recording, place, images)
            written.append(place)
    if progress is not None:
        progress("recordings", len(points), len(points))
    return written

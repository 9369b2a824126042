"""The suite: run over all its cases, or written as recordings for other programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from scenetruth.benchmark.benchmark_report import write_benchmark_report
from scenetruth.benchmark.benchmark_result import BenchmarkResult
from scenetruth.benchmark.benchmark_tasks import BenchmarkTask, list_design_points, measure_point, read_point_result
from scenetruth.benchmark.cases.case import SUITES, BenchmarkRecord, Case, all_cases, select_cases
from scenetruth.benchmark.design_point import add_noise, ignore_scene_warnings, read_error_maps
from scenetruth.benchmark.error_statistics import compute_efficiency_records
from scenetruth.errors import ArgumentError, EstimateError, Problem
from scenetruth.estimators.external import recording_key, write_recording
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, read_methods
from scenetruth.jobs.executors import describe_pickling_error, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.output import write_atomically
from scenetruth.progress import Progress, say
from scenetruth.scene import Scene
from scenetruth.simulation import simulate

__all__ = ["compare", "select_available_cases", "write_recordings"]


INDEX = "comparison.json"
"""What a folder of a comparison is known by."""
_FOLDER = JobFolder(INDEX, "a comparison", "points")


def compare(
    methods: Iterable[MethodLike] | MethodLike,
    *,
    suite: str = "core",
    cases: Sequence[str] | None = None,
    levels: Sequence[float | str] | None = None,
    output: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> BenchmarkResult:
    """Find out how accurate methods are, over the cases of the metrology suite.

    Every case varies one thing: noise, contrast, wavelength, slope, disparity, motion, the distance from an outline,
    and more. All methods get the same images. What is done stays in the folder, and is not done again;
    what failed is, and what a method of your own gave before its code changed.

    Parameters
    ----------
    methods
        One or several: names, ``"module:function"``, methods or functions, or `scenetruth.estimators.MethodSpec` with
        settings and a label.
    suite
        ``"core"``, for every day, or ``"full"``, with more values and more noises.
    cases
        Only these cases, by their kinds.
    levels
        Only these values of what is varied, for a single case; labels where values have some, as names of scenes.
    output
        Where figures are kept: the page ``index.html``, ``results.parquet``, ``results.csv``, ``summary.csv``, and a
        file for each scene. If not given, nothing is kept.
    workers
        Processes of this machine, of one thread each: 1, the default, for none besides this process, -1 for all
        processors.
    scheduler
        Address of a Dask scheduler, whose workers are used instead. They must see the folder by the same path.
    progress
        Called with (what, done, total).

    Returns
    -------
    Comparison
        All figures.

    Raises
    ------
    ArgumentError
        If the number of workers is impossible, or a scheduler has no folder.
    EstimateError
        If there is no such method, a setting is impossible, or a function cannot be sent to another process.
    ArgumentError
        If there is no such suite, case or value, or a case needs what is not there.
    OutputExistsError
        If the folder holds a comparison of other methods, or something else.

    See Also
    --------
    score : One estimate against one truth.

    Examples
    --------
    >>> import scenetruth as st
    >>> found = st.compare("structure_tensor", cases=["noise"], levels=[0.005])
    >>> row = found.value("flow_x", case="noise", method="structure_tensor")
    >>> bool(row.ci_low < row.value < row.ci_high), row.unit
    (True, 'px/frame')
    """
    contestants = read_methods(methods)
    chosen = select_available_cases(suite, cases, levels)
    resolve_workers(workers)
    _refuse_what_cannot_travel(contestants, workers, scheduler)
    identity = {"format": 1, "suite": suite, "methods": [one.spelled for one in contestants]}
    with _FOLDER.open(output, identity, other=_describe_other, scheduler=scheduler) as place:
        points = list_design_points(chosen, suite, levels)
        job = BenchmarkTask(
            str((place / "points").resolve()),
            tuple(points),
            tuple(contestants),
            tuple(sorted(collect_versions().items())),
        )
        missing = [number for number in range(len(points)) if not job.is_done(number)]
        if len(missing) < len(points):
            kept = len(points) - len(missing)
            say(f"kept from earlier: {kept} of {len(points)} scenes; {len(missing)} to be measured")
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
        slips: Counter[str] = Counter()
        for number, point in enumerate(points):
            if number in done.failed:
                continue
            measured = read_point_result(job.path(number))
            rows += measured.rows
            failures += [f"{point.case} at {point.name}: {label}: {why}" for label, why in measured.failures.items()]
            slips.update(f"{label}: {told}" for label, found_here in measured.slips.items() for told in found_here)
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
            [f"{told} (at {count} of {len(points)} scenes)" for told, count in slips.most_common()],
        )
        if output is not None:
            _write_tables(found, place)
            maps = {
                (point.case, value): one
                for number, point in enumerate(points)
                if (one := read_error_maps(job.path(number).with_suffix(".npz"))) is not None
                for value in point.values
            }
            write_benchmark_report(found, [one.words for one in contestants], place, suite, maps)
    return found


def select_available_cases(
    suite: str,
    cases: Sequence[str] | None,
    values: Sequence[float | str] | None,
) -> list[Case]:
    """Return the cases that are asked for; of all, those that a suite has and that can be measured here."""
    problems = []
    if suite not in SUITES:
        problems.append(Problem("suite", f"must be one of {', '.join(SUITES)}", suite))
    if values is not None and (cases is None or len(cases) != 1):
        problems.append(Problem("levels", "are those of one case: name it", list(values)))
    chosen: list[Case] = []
    try:
        chosen = select_cases(cases)
    except ArgumentError as error:
        problems += error.problems
    named = cases is not None
    if named and not problems:
        problems += [problem for case in chosen for problem in _unfit(case, suite, values)]
    if problems:
        raise ArgumentError(problems)
    if not named:
        for case in chosen:
            if case.lacks() and suite == "full":
                say(f"case {case.kind} is left out: it {case.lacks()}")
    return chosen if named else [case for case in chosen if case.values(suite) and not case.lacks()]


def _unfit(case: Case, suite: str, values: Sequence[float | str] | None) -> Iterable[Problem]:
    """Give what is wrong with a case that is named, and with its values."""
    if case.lacks():
        yield Problem("cases", case.lacks(), case.kind)
    elif values is None:
        if not case.values(suite):
            yield Problem(
                "cases", f"has no values in the suite {suite}: choose the suite full, or name values", case.kind
            )
    else:
        for value in values:
            try:
                case.value_of(value)
            except ArgumentError as error:
                yield from error.problems


def _refuse_what_cannot_travel(contestants: Sequence[MethodSpec], workers: int, scheduler: str | None) -> None:
    problems = []
    for one in contestants:
        if why := describe_pickling_error(one, workers, scheduler):
            message = f"cannot be sent to another process ({why}); give 'module:function', or workers=1"
            problems.append(Problem("methods", message, one.label))
    if problems:
        raise EstimateError(problems)


def _describe_other(there: Any) -> str:
    held = f"suite {there.get('suite')} of {there.get('methods')}" if isinstance(there, dict) else "something else"
    return f"holds another comparison: {held}; choose another folder"


def _write_tables(found: BenchmarkResult, folder: Path) -> None:
    frame = found.to_dataframe()
    with write_atomically(folder / "results.parquet", overwrite=True) as aside:
        frame.to_parquet(aside)
    with write_atomically(folder / "results.csv", overwrite=True) as aside:
        frame.to_csv(aside, index=False)
    with write_atomically(folder / "summary.csv", overwrite=True) as aside:
        found.ranking().to_csv(aside)


def write_recordings(
    folder: str | Path,
    suite: str = "core",
    *,
    cases: Sequence[str] | None = None,
    levels: Sequence[float | str] | None = None,
    images: Literal["png", "tiff", "npy"] = "png",
    progress: Progress | None = None,
) -> list[Path]:
    """Write all recordings of a suite, each into a folder that is named by its key.

    What a program finds of them goes into folders of the same names, which
    `scenetruth.estimators.external.ResultsFolder` reads. Recordings that are there are not written again.
    """
    if Path(folder).is_file():
        raise EstimateError([Problem("recordings", "must be a folder", folder)])
    points = list_design_points(select_available_cases(suite, cases, levels), suite, levels)
    written = []
    for done, point in enumerate(points):
        if progress is not None:
            progress("recordings", done, len(points))
        case = all_cases()[point.case]
        noise_std = case.noise_std(point.values[0])
        with ignore_scene_warnings():
            ideal = simulate(Scene.from_dict(case.scene(point.values[0])))[0]
        for seed in range(point.seeds if noise_std else 1):
            recording = add_noise(ideal, noise_std, case.kind, seed)
            place = Path(folder) / recording_key(recording)
            if not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                write_recording(recording, place, images)
            written.append(place)
    if progress is not None:
        progress("recordings", len(points), len(points))
    return written

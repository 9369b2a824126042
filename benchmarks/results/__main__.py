"""Measure methods and write the results pages: ``make results``, or ``python -m benchmarks.results``.

Existing results in FOLDER are reused; an interrupted run is resumed by the same command. ``--add`` measures one more
method only, and adds its row. ``--case`` is a trial: it prints the values of a case and writes no page.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.peers.catalogue import PEERS
from benchmarks.peers.setup import FOLDER, make_environment
from benchmarks.results.contestants import CONTESTANTS, PROGRAM, Contestant, submitted
from benchmarks.results.cost import cost_of
from benchmarks.results.data import COLUMNS, MethodData, spelled, table_of, write_csv, write_method_data
from benchmarks.results.four_images import four_images_table, measure_four_images
from benchmarks.results.jobs import Job, list_jobs, measure_jobs, processor_name, stored_cost, stored_rows
from benchmarks.results.pages import FOUR_IMAGES, PAGES, write_pages
from scenetruth.benchmark.cases import all_cases
from scenetruth.errors import ArgumentError, Problem, ScenetruthError


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what is missing, and write data and pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--add", metavar="METHOD", help="[LABEL=]MODULE:FUNCTION, or command:LABEL=WORDS")
    parser.add_argument("--link", default="", metavar="URL", help="address of the code of the added method")
    parser.add_argument("--version", default="", metavar="TEXT", help="version of the added method")
    parser.add_argument("--case", action="append", metavar="NAME", help="a trial of this case; repeatable")
    parser.add_argument("--level", action="append", metavar="LEVEL", help="only this level of the case; repeatable")
    parser.add_argument("--method", action="append", metavar="KEY", help="only this method; repeatable")
    parser.add_argument("--folder", type=Path, default=Path("outputs/results"), help="results (outputs/results)")
    parser.add_argument("--peers", type=Path, default=FOLDER, help="environments of programs (outputs/peers)")
    parser.add_argument("--docs", type=Path, default=Path("docs/results"), help="pages and data (docs/results)")
    parser.add_argument("--fresh", action="store_true", help="measure again what is there")
    parser.add_argument("--stored", action="store_true", help="measure nothing: data and pages of what is in FOLDER")
    parser.add_argument("--pages", action="store_true", help="write pages from the data only")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    started = time.perf_counter()
    try:
        check(given)
        if given.case:
            print(trial(given))
            return
        if not given.pages:
            measure_all(given)
        written = write_pages(given.docs)
    except (ScenetruthError, OSError) as error:
        raise SystemExit(str(error)) from None
    for file in written:
        print(f"wrote {file}")
    print(f"{time.perf_counter() - started:.0f} s")


def check(given: argparse.Namespace) -> None:
    """Raise an error with every wrong argument, before environments are made and anything is measured."""
    cases, keys = all_cases(), [one.key for one in CONTESTANTS]
    problems = [
        Problem("--case", f"must be one of {', '.join(cases)}", name) for name in given.case or () if name not in cases
    ]
    if given.level and not given.case:
        problems.append(Problem("--level", "needs --case: all levels of the suite are measured otherwise", given.level))
    for name in given.method or ():
        if given.add:
            problems.append(Problem("--method", "must not be given with --add, which measures one method", name))
        elif name not in keys:
            problems.append(Problem("--method", f"must be one of {', '.join(keys)}", name))
    absent = [name for name in PAGES if not given.case and not (given.docs / name).is_file()]
    if absent:
        remedy = "call the command in a checkout of the project, or give its docs/results"
        problems.append(Problem("--docs", f"has no {', '.join(absent)}; {remedy}", str(given.docs)))
    if problems:
        raise ArgumentError(problems)
    for name in given.case or ():
        for level in given.level or ():
            cases[name].parse_level(level)


def chosen_by(given: argparse.Namespace) -> Sequence[Contestant]:
    """Return the methods that are asked for, after their environments were made."""
    chosen: Sequence[Contestant] = CONTESTANTS
    if given.add:
        chosen = [submitted(given.add, given.link, given.version)]
    if given.method:
        chosen = [one for one in chosen if one.key in given.method]
    programs = [] if given.stored else [one for one in chosen if one.group == PROGRAM]
    for name in sorted({PEERS[one.key].environment for one in programs}):
        print(f"environment {name}: {make_environment(given.peers, name)}", flush=True)
    return chosen


def trial(given: argparse.Namespace) -> str:
    """Measure cases, and return the table of their values."""
    jobs = list_jobs(given.case, given.level)
    lines = []
    for one in chosen_by(given):
        with tempfile.TemporaryDirectory(prefix="trial-") as folder:
            list(measure_jobs(jobs, [one], Path(folder), given.peers))
            data = data_of(one, jobs, Path(folder), {})
        lines += [f"{one.title}, {job}: no result: {why}" for job, why in data.failures.items()]
        shown = data.table[[*COLUMNS[:5], "valid_percent", "bad_percent", "rms_z"]]
        lines.append(f"{one.title}\n{shown.to_string(index=False, na_rep='', float_format=spelled)}")
    return "\n".join(lines)


def measure_all(given: argparse.Namespace) -> None:
    """Measure what is missing, unless stored results are wanted only, and write the data."""
    jobs, chosen = list_jobs(), chosen_by(given)
    for job, key, seconds in (
        () if given.stored else measure_jobs(jobs, chosen, given.folder, given.peers, fresh=given.fresh)
    ):
        print(f"{job}, {key}: {seconds:.1f} s", flush=True)
    for one in chosen:
        measured = dict if given.stored else partial(cost_of, one, given.folder, given.peers)
        cost = stored_cost(one, given.folder, measured, fresh=given.fresh and not given.stored)
        print(f"cost, {one.key}: {cost.get('processor_s', float('nan')):.2f} s per frame", flush=True)
        write_method_data(given.docs / "data" / "methods", data_of(one, jobs, given.folder, cost))
    if not (given.add or given.method):
        for name, seconds in () if given.stored else measure_four_images(given.folder, given.peers):
            print(f"four images, {name}: {seconds:.1f} s", flush=True)
        write_csv(given.docs / "data" / FOUR_IMAGES, four_images_table(given.folder))


def data_of(one: Contestant, jobs: Sequence[Job], folder: Path, cost: dict[str, float]) -> MethodData:
    """Return all that was measured of a method.

    Parameters
    ----------
    one
        The method.
    jobs
        The jobs.
    folder
        Folder of the results.
    cost
        Time and memory.
    """
    rows, failures, missing, others = stored_rows(jobs, one, folder)
    return MethodData(
        *(one.key, one.title, one.group, one.images, one.how, one.link),
        version=others[-1]["version"] if others else "",
        date=max((other["date"] for other in others), default=""),
        machine=others[-1]["machine"] if others else processor_name(),
        processor_s=round(sum(other["processor_s"] for other in others), 1),
        cost={name: float(f"{value:.3g}") for name, value in cost.items()},
        failures=failures,
        missing=tuple(missing),
        table=table_of(rows),
    )


if __name__ == "__main__":
    main(sys.argv[1:])

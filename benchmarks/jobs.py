"""Jobs of a benchmark, one after the other or in processes, each kept in a file as it ends.

``--workers 8`` shares the jobs among processes; NUMBA_NUM_THREADS says how many threads each has. ``--kept FILE``
appends what a job ends with as a line of JSON, and takes what an earlier run has kept: a run that is cut short goes on
where it was.
"""

from __future__ import annotations

import argparse
import inspect
import json
import multiprocessing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

__all__ = ["arguments", "ends", "heading", "line", "number", "pair"]

Cells = Sequence[Any]


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of what all benchmarks take.

    Parameters
    ----------
    description
        What the benchmark does.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="run only the cases whose names contain one of these")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="change every scene")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--kept", type=Path, help="file of ends of jobs")
    return parser


def ends(
    work: Callable[..., Any], jobs: Mapping[str, Sequence[Any]], given: argparse.Namespace
) -> Iterator[tuple[str, Any]]:
    """Give name and end of every job that is asked for, in their order.

    Parameters
    ----------
    work
        A function of a module, whose results JSON can spell.
    jobs
        Its arguments for every job, by name.
    given
        What `arguments` parsed.
    """
    wanted = {name: job for name, job in jobs.items() if not given.names or any(part in name for part in given.names)}
    # What was made of changed scenes is another job.
    home = Path(inspect.getfile(work)).stem
    keys = {name: json.dumps([home, name, *given.set]) for name in wanted}
    kept = dict(_lines(given.kept))
    left = [name for name in wanted if keys[name] not in kept]

    def keep(name: str, end: Any) -> None:
        kept[keys[name]] = end
        if given.kept is not None:
            with given.kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps([keys[name], end]) + "\n")

    if given.workers == 1:
        for name in wanted:
            if name in left:
                keep(name, _quietly(work, *wanted[name]))
            yield name, kept[keys[name]]
        return
    with ProcessPoolExecutor(given.workers, multiprocessing.get_context("spawn")) as pool:
        futures: dict[str, Future[Any]] = {}
        for name in left:
            futures[name] = pool.submit(_quietly, work, *wanted[name])
            futures[name].add_done_callback(lambda done, name=name: done.exception() or keep(name, done.result()))
        for name in wanted:
            if name in futures:
                futures[name].result()
            yield name, kept[keys[name]] if keys[name] in kept else futures[name].result()


def _quietly(work: Callable[..., Any], *job: Any) -> Any:
    """Do a job; what warnings tell of a scene is known to who benchmarks with it."""
    warnings.simplefilter("ignore")
    return work(*job)


def _lines(file: Path | None) -> Iterator[tuple[str, Any]]:
    """Give what a file has kept; the last line of a run that was killed may be cut."""
    if file is None or not file.exists():
        return
    for text in file.read_text(encoding="utf-8").splitlines():
        try:
            key, end = json.loads(text)
        except ValueError:
            continue
        yield key, end


def number(value: float | None) -> str:
    """Spell a number with two digits; nothing is a dash."""
    return "–" if value is None else f"{float(f'{value:.1e}'):g}"


def pair(values: Mapping[str, float | None]) -> str:
    """Spell the median and the root of the mean square of what a score tells of a quantity."""
    return f"{number(values.get('median_abs_error'))} / {number(values.get('rmse'))}" if values.get("count") else "–"


def heading(columns: Cells) -> str:
    """Return the first two lines of a table in Markdown."""
    return f"{line(columns)}\n|{len(columns) * '---|'}"


def line(cells: Cells) -> str:
    """Return a line of a table in Markdown."""
    return f"| {' | '.join(map(str, cells))} |"

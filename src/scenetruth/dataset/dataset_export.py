"""Export of all samples of a data set to another format."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenetruth.dataset.fingerprint import open_sampler, read_fingerprint
from scenetruth.dataset.layout import DatasetFolder, compute_shard_number, extract_sample
from scenetruth.dataset.samples import SampleStore
from scenetruth.errors import ExportError, StoreError
from scenetruth.exporters import choose_format
from scenetruth.jobs.executors import resolve_workers
from scenetruth.jobs.results import TaskResult, perform_task
from scenetruth.jobs.scheduler import ParallelResult, for_each
from scenetruth.pipeline import export_run
from scenetruth.progress import Progress, say

__all__ = ["export_dataset", "try_export"]

_Arguments = tuple[str, str, str, str | None, int, str]
"""What `try_export` is given beside the number."""


def export_dataset(
    folder: str | Path,
    out: str | Path,
    format: str,
    *,
    numbers: Sequence[int] | None = None,
    method: str | None = None,
    workers: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> ParallelResult:
    """Write every sample of a data set in a format of others, each into a folder of its own: ``OUT/00000417``.

    Samples that are there already stay as they are, so that what was interrupted can be repeated.

    Parameters
    ----------
    folder
        The data set.
    out
        Folder of the folders.
    format
        Name of the format; see `scenetruth.export_formats`.
    numbers
        Numbers of the samples; all that are there if not given.
    method
        Write the estimates of this method; the truth if not given.
    workers, threads, scheduler
        As of `run_dataset`.
    progress
        Called with (what, done, total).
    **options
        Options of the format.

    Returns
    -------
    Each
        How many were written, and what went wrong.

    Raises
    ------
    ExportError
        If there is no such format, its options do not fit, or the first and the last sample both lack what it needs.
    StoreError
        If there is no data set, or ``out`` is inside of it.
    """
    resolve_workers(workers)
    choose_format(format, options)
    places, target = DatasetFolder(folder), Path(out)
    if target.resolve().is_relative_to(places.path.resolve()):
        raise StoreError(target, "is inside the data set; give a folder elsewhere")
    identity, sampler = read_fingerprint(places), open_sampler(places)
    there = SampleStore.of(places, sampler, identity).present(range(identity.count))
    wanted = sorted(there if numbers is None else there.intersection(numbers))
    missing = [number for number in wanted if not (target / f"{number:08d}").exists()]
    per_shard = sampler.recipe.samples_per_shard
    arguments = (str(places.path.resolve()), str(target.resolve()), format, method, per_shard, json.dumps(options))
    tried = _refuse_all(missing, arguments)
    found = for_each(
        [number for number in missing if number not in tried],
        try_export,
        arguments,
        present=len(wanted) - len(missing) + len(tried),
        workers=workers,
        threads=threads,
        scheduler=scheduler,
        what="export",
        progress=progress,
        notice=say,
    )
    found.present -= len(tried)
    found.done += len(tried)
    return found


def _refuse_all(numbers: Sequence[int], arguments: _Arguments) -> set[int]:
    """Refuse what none of the samples can be written as; return the sample that was written to know it.

    Samples of one recipe have data sets of one kind: where the first and the last lack the same, the others do too.
    """
    lacking = []
    for number in dict.fromkeys([*numbers[:1], *numbers[-1:]]):
        try:
            _export(*arguments, number)
        except ExportError as error:
            lacking.append(error)
        except Exception:  # it is met, and told, once more
            return set()
        else:
            return {number}
    if lacking and all(error.problems == lacking[0].problems for error in lacking):
        raise ExportError(lacking[0].problems, source="every sample")
    return set()


def _export(folder: str, out: str, format: str, method: str | None, per_shard: int, options: str, number: int) -> None:
    places, target = DatasetFolder(folder), Path(out) / f"{number:08d}"
    shard = places.shard(compute_shard_number(number, per_shard))
    if shard.exists():
        with extract_sample(shard, number) as files:
            export_run(files, target, format, method=method, **json.loads(options))
    else:
        export_run(places.sample(number), target, format, method=method, **json.loads(options))


def try_export(
    folder: str, out: str, format: str, method: str | None, per_shard: int, options: str, number: int
) -> TaskResult:
    """Write one sample, for whoever works through many: what goes wrong is returned."""

    def work() -> dict[str, Any]:
        _export(folder, out, format, method, per_shard, options, number)
        return {}

    return perform_task(number, work)

"""Export of all samples of a data set to another format."""

from __future__ import annotations

import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import xarray as xr

from scenetruth.dataset.fingerprint import open_sampler, read_fingerprint
from scenetruth.dataset.layout import DatasetFolder, compute_shard_number, extract_sample
from scenetruth.dataset.samples import SampleStore
from scenetruth.dataset.verification import verify_dataset
from scenetruth.errors import ExportError, Problem, StoreError
from scenetruth.exporters import ExportResult, choose_format, export_data
from scenetruth.jobs.executors import resolve_workers
from scenetruth.jobs.results import TaskResult, perform_task
from scenetruth.jobs.scheduler import ParallelResult, for_each
from scenetruth.pipeline import VerificationResult, export_run, verify_run
from scenetruth.progress import Progress, say

__all__ = ["export", "export_dataset", "verify"]

_Arguments = tuple[str, str, str, str | None, int, str]
"""Arguments of `try_export` other than the number."""


def export(
    source: str | PathLike[str] | tuple[xr.Dataset, xr.Dataset],
    format: str,
    *,
    output: str | Path,
    method: str | None = None,
    row: int | None = None,
    overwrite: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
    **options: Any,
) -> ExportResult:
    """Write a recording and its truth, or an estimate, in another format.

    Parameters
    ----------
    source
        The directory of a run, the directory of a data set (every sample is written), or a recording with its truth
        or an estimate. Displacements to other frames require a complete truth (``truth_content="complete"``).
    format
        Name of the format; see `export_formats` and ``docs/how_to/export.md``.
    output
        Output directory; for a data set, with one subdirectory per sample: ``OUTPUT/00000417``.
    method
        Export the estimate of this method; default: the truth.
    row
        Row ``s_y`` of a camera grid.
    overwrite
        Whether an earlier export may be replaced; other files are kept.
    workers
        Processes for the samples of a data set; -1 for all processors.
    progress
        Called with (what, done, total), of a data set.
    **options
        Options of the format, such as ``left=0`` or ``flow="instantaneous"``.

    Returns
    -------
    ExportResult
        The files (for a data set, the directories of the samples) and the notes of the export. The same information
        is in the file ``export.json``.

    Raises
    ------
    ExportError
        If the format, its options or the data sets are incompatible; lists every problem.
    MismatchError
        If recording and maps belong to different runs.
    StoreError
        If a store is missing or damaged, or ``output`` exists or cannot be written.

    See Also
    --------
    export_formats : List the formats.
    verify : Verify a directory.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 2, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> estimate = st.make_estimate(depth=np.ones((2, 8, 8)), recording=recording)
    >>> with TemporaryDirectory() as folder:
    ...     done = st.export((recording, estimate), "opencv_yaml", output=f"{folder}/cameras")
    >>> done.files
    ('s+0.yml', 's+1.yml')
    """
    if isinstance(source, tuple):
        recording, maps = source
        wrong = [
            Problem(name, "applies only to directories of runs and data sets", value)
            for name, value in (("method", method), ("row", row))
            if value is not None
        ]
        if wrong:
            raise ExportError(wrong)
        return export_data(recording, maps, output, format, overwrite=overwrite, **options)
    if not DatasetFolder(Path(source)).identity.exists():
        return export_run(Path(source), output, format, method=method, row=row, overwrite=overwrite, **options)
    found = export_dataset(
        Path(source),
        output,
        format,
        method=method,
        row=row,
        overwrite=overwrite,
        workers=workers,
        progress=progress,
        **options,
    )
    made = tuple(sorted(path.name for path in Path(output).iterdir() if path.is_dir()))
    return ExportResult(Path(output), made, (), dict(found.failed))


def verify(
    path: str | Path, *, regenerate: int = 0, seed: int = 0, progress: Progress | None = None
) -> list[VerificationResult]:
    """Verify the checksums of every result of a run, of a data set, or of a single store.

    Parameters
    ----------
    path
        The directory, or the store.
    regenerate
        Number of randomly selected samples of a data set that are regenerated and compared bit by bit.
    seed
        Seed of the selection.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of VerificationResult
        For a run: one result per scene, store and score, and one for inconsistent parts. For a data set: one result
        per damaged or missing sample, and per damaged file of the catalogue, the card and the scores.

    Raises
    ------
    StoreError
        If the path contains no results of scenetruth.

    See Also
    --------
    load_store : Loads a store and verifies it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     [(found.path.name, found.problem) for found in verify(folder)]
    [('recording.zarr', '')]
    """
    places = DatasetFolder(Path(path))
    if not places.identity.exists():
        return verify_run(path, progress)
    found = verify_dataset(path, regenerate=regenerate, seed=seed, progress=progress)
    return [
        VerificationResult(places.path / one.file if one.number is None else places.sample(one.number), one.problem)
        for one in found
    ]


def export_dataset(
    folder: str | Path,
    out: str | Path,
    format: str,
    *,
    numbers: Sequence[int] | None = None,
    method: str | None = None,
    row: int | None = None,
    overwrite: bool = False,
    workers: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> ParallelResult:
    """Write every sample of a data set in another format, each into its own directory: ``OUT/00000417``.

    Existing samples are reused, so that an interrupted export resumes when it is repeated; with ``overwrite`` every
    sample is exported again.
    """
    resolve_workers(workers)
    choose_format(format, options)
    places, target = DatasetFolder(folder), Path(out)
    if target.resolve().is_relative_to(places.path.resolve()):
        raise StoreError(target, "is inside the data set; specify a directory outside it")
    identity, sampler = read_fingerprint(places), open_sampler(places)
    store = SampleStore.of(places, sampler, identity)
    there = store.present(range(identity.count))
    store.refuse_empty(there)
    wanted = sorted(there if numbers is None else there.intersection(numbers))
    missing = [number for number in wanted if overwrite or not (target / f"{number:08d}").exists()]
    per_shard = sampler.recipe.samples_per_shard
    text = json.dumps({"row": row, "overwrite": overwrite, **options})
    arguments = (str(places.path.resolve()), str(target.resolve()), format, method, per_shard, text)
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
    """Raise if no sample can be exported; return the numbers of the samples that were exported for this test.

    Samples of one recipe have the same structure: what the first and the last lack, all lack.
    """
    lacking = []
    for number in dict.fromkeys([*numbers[:1], *numbers[-1:]]):
        try:
            _export(*arguments, number)
        except ExportError as error:
            lacking.append(error)
        except Exception:  # raised and reported again by the export
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
    """Export one sample in a worker; exceptions are returned."""

    def work() -> dict[str, Any]:
        _export(folder, out, format, method, per_shard, options, number)
        return {}

    return perform_task(number, work)

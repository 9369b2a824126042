"""Verification and export of the results in a run directory, and strain of its estimates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from scenetruth.errors import ExportError, MismatchError, Problem, ScenetruthError, StoreError
from scenetruth.exporters import ExportResult, choose_format, export_data
from scenetruth.output import check_output, claim_folder, write_atomically
from scenetruth.pipeline.run_directory import RunDirectory
from scenetruth.progress import Progress
from scenetruth.scene import load_scene
from scenetruth.schema import check_same_run
from scenetruth.storage import is_store, load_store, open_store, save_store, verify_store

if TYPE_CHECKING:
    from scenetruth.strain import GoodPracticeReport, StrainScore, StrainSettings

__all__ = ["StrainRun", "VerificationResult", "export_run", "run_strain", "verify_run"]


@dataclass(frozen=True)
class VerificationResult:
    """Result of the verification of a file or store; ``problem`` is empty if there is none."""

    path: Path
    problem: str = ""


def verify_run(folder: str | Path, progress: Progress | None = None) -> list[VerificationResult]:
    """Verify the checksums of every result in a run directory, or of a single store.

    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     [(found.path.name, found.problem) for found in verify_run(folder)]
    [('recording.zarr', '')]
    """
    path = Path(folder)
    if is_store(path):
        parts = [path]
    elif path.is_dir():
        parts = list(_parts(RunDirectory(path)))
    else:
        raise StoreError(path, "no such directory")
    if not parts:
        raise StoreError(path, "contains no results of scenetruth")
    verdicts = []
    for done, part in enumerate(parts):
        if progress is not None:
            progress("verify", done, len(parts))
        verdicts.append(VerificationResult(part, _problem(part)))
    if progress is not None:
        progress("verify", len(parts), len(parts))
    whole = [verdict.path for verdict in verdicts if not verdict.problem and _is_named_store(verdict.path)]
    try:
        check_same_run({str(store): open_store(store).attrs for store in whole})
    except MismatchError as error:
        verdicts += [VerificationResult(Path(problem.path), problem.message) for problem in error.problems]
    return verdicts


def _parts(run: RunDirectory) -> Iterator[Path]:
    yield from (file for file in (run.scene, run.recording, run.truth) if file.exists())
    yield from sorted(run.stores("estimate*"))
    yield from sorted(run.path.glob("score*.json"))


def _is_named_store(path: Path) -> bool:
    return path.name.endswith((".zarr", ".zarr.zip"))


def _problem(part: Path) -> str:
    from scenetruth.scoring import Score

    try:
        if _is_named_store(part):
            verify_store(part)
        elif part.suffix == ".json":
            Score.load(part)
        else:
            load_scene(part)
    except StoreError as error:
        return error.message
    except ScenetruthError as error:
        return str(error)
    except (OSError, UnicodeDecodeError) as error:
        return f"cannot be read: {error}"
    return ""


def export_run(
    folder: str | Path,
    out: str | Path,
    format: str,
    *,
    method: str | None = None,
    row: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> ExportResult:
    """Write the recording of a run, and its truth or an estimate, in another format.

    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 2, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> estimate = st.make_estimate(depth=np.ones((2, 8, 8)), recording=recording)
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     _ = st.save_store(estimate, f"{folder}/estimate.zarr")
    ...     done = st.export(folder, "opencv_yaml", output=f"{folder}/cameras", method="structure_tensor")
    >>> done.files
    ('s+0.yml', 's+1.yml')
    """
    # Errors of the call are reported before stores are opened.
    choose_format(format, options)
    run = RunDirectory(folder)
    recording = open_store(run.check_recording(), kind="recording")
    maps = _open_maps(run, method)
    if row is not None:
        maps = _row_of_maps(recording, maps, row, "truth" if method is None else "estimate")
        recording = recording.sel(s_y=row)
    return export_data(recording, maps, out, format, overwrite=overwrite, **options)


def _open_maps(run: RunDirectory, method: str | None) -> xr.Dataset:
    if method is not None:
        return open_store(run.check_estimate(method), kind="estimate")
    if not run.truth.exists():
        remedy = "select an estimate with --method NAME (method='NAME')"
        raise StoreError(run.truth, f"no such store: the run has no truth; {remedy}")
    return open_store(run.truth, kind="truth")


def _row_of_maps(recording: xr.Dataset, maps: xr.Dataset, row: int, what: str) -> xr.Dataset:
    rows = recording["s_y"].values.tolist() if "s_y" in recording["image"].dims else []
    if row not in rows:
        message = f"must be one of the rows {rows}" if rows else "applies only to camera grids, not to a single row"
        raise ExportError([Problem("row", message, row)])
    # Maps of the reference camera belong to its row, also if other variables cover all rows.
    if row != 0 and not any(
        "s_y" in item.dims and "x" in item.dims for name, item in maps.items() if name != "visible"
    ):
        raise ExportError([Problem("row", f"must be 0: the {what} covers only this row", row)])
    return maps.sel(s_y=row) if "s_y" in maps.dims else maps


@dataclass(frozen=True, eq=False)
class StrainRun:
    """Strain of a run: maps, statistics of their errors (None without a truth), and fields of good practice.

    ``method``: The method of the estimate; empty for the truth.
    """

    strain: xr.Dataset
    score: StrainScore | None
    practice: GoodPracticeReport
    method: str


STRAIN_FILES = ("good_practice.json", "good_practice.csv", "strain_score.json", "strain_score.csv", "strain.zarr")
"""Entries of a directory that `run_strain` writes."""


def run_strain(
    folder: str | Path,
    output: str | Path,
    *,
    method: str | None = None,
    settings: StrainSettings,
    since: int | None = None,
    overwrite: bool = False,
    allow_mismatch: bool = False,
) -> StrainRun:
    """Write the strain of an estimate of a run, its score and the fields of good practice into a directory.

    Without ``method`` the first estimate is used, or the truth if there is no estimate.
    """
    from scenetruth.strain import compute_strain, report_good_practice, score_strain

    claim = claim_folder(*STRAIN_FILES)
    check_output(output, overwrite=overwrite, claim=claim)
    run = RunDirectory(folder)
    recording = open_store(run.check_recording(), kind="recording")
    if method is None and run.stores("estimate*"):
        method = run.estimated()[0]
    truth = load_store(run.truth, kind="truth") if run.truth.exists() else None
    score = None
    if method is None:
        if truth is None:
            raise StoreError(run.truth, "no such store, and the run has no estimate; run `scenetruth estimate`")
        maps = truth
    else:
        maps = load_store(run.check_estimate(method), kind="estimate")
        if truth is not None:
            scene = load_scene(run.scene) if run.scene.exists() else None
            score = score_strain(maps, truth, scene, settings=settings, since=since, allow_mismatch=allow_mismatch)
    strain = compute_strain(maps, settings=settings, since=since)
    practice = report_good_practice(recording, maps if method is not None else None, strain)
    with write_atomically(output, overwrite=overwrite, claim=claim) as partial:
        partial.mkdir()
        save_store(strain, partial / "strain.zarr")
        practice.save(partial / "good_practice.json")
        (partial / "good_practice.csv").write_text(practice.to_csv(), encoding="utf-8")
        if score is not None:
            score.save(partial / "strain_score.json")
            table = score.to_dataframe().to_csv(index=False, lineterminator="\n")
            (partial / "strain_score.csv").write_text(str(table), encoding="utf-8")
    return StrainRun(strain, score, practice, method or "")

"""Verification of a data set against its checksums, and the catalogue rebuilt from the samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenetruth.dataset.catalogue import (
    FILES,
    SCORES_REMEDY,
    build_catalogue_table,
    describe_remedy,
    list_parts,
    read_catalogue,
    replace_catalogue,
    require_parquet,
)
from scenetruth.dataset.checksums import check_listed, file_sha256, list_path, load_record
from scenetruth.dataset.fingerprint import CHECKED_FORMAT, DatasetFingerprint, open_sampler, read_fingerprint
from scenetruth.dataset.layout import SAMPLE, DatasetFolder, compute_shard_number, extract_sample
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import SampleStore, make_sample
from scenetruth.errors import RecipeError, ScenetruthError, StoreError
from scenetruth.output import lock_output
from scenetruth.pipeline import RunDirectory
from scenetruth.progress import Progress
from scenetruth.random_streams import generator_for
from scenetruth.storage import verify_store

__all__ = ["VerificationFailure", "rebuild_catalogue", "verify_dataset"]

_AGAIN = "remove the sample, and run the data set again"
_SCORE_AGAIN = "remove it and the record of its sample in scores/, and estimate the data set again"
_OLD = (
    "has the format of an earlier version, without checksums of sample.json, catalogue and card: they were compared "
    "with each other only; generate the data set again for checksums"
)


@dataclass(frozen=True)
class VerificationFailure:
    """A damaged or missing sample, or a damaged ``file`` of the data set, whose ``number`` is None."""

    number: int | None
    problem: str
    file: str = ""

    @property
    def name(self) -> str:
        """The sample or the file, for messages."""
        return self.file if self.number is None else f"sample {self.number}"


def verify_dataset(
    folder: str | Path, *, regenerate: int = 3, seed: int = 0, progress: Progress | None = None
) -> list[VerificationFailure]:
    """Verify the checksums of a data set, and regenerate randomly selected samples bit-identically.

    Everything that a data set states is verified: recipe, identity, samples with their records, catalogue, card and
    scores. Files are read as bytes before their content is parsed.
    """
    places = DatasetFolder(folder)
    found: list[VerificationFailure] = []
    listed = _check_lists(places)
    try:
        identity, sampler = read_fingerprint(places), open_sampler(places)
    except (StoreError, RecipeError) as error:
        if not listed:
            raise
        # The list of checksums names the damaged file.
        return [*listed, VerificationFailure(None, str(error), places.identity.name)]
    store = SampleStore.of(places, sampler, identity)
    present = store.present(range(identity.count))
    if not listed:
        store.refuse_empty(present)
    checked = identity.format >= CHECKED_FORMAT
    if checked:
        found += listed
    else:
        found += [one for one in listed if "has no checksum" not in one.problem]
        found.append(VerificationFailure(None, _OLD, places.identity.name))
    rows = _read_rows(places, sampler, found)
    records: dict[int, dict[str, Any]] = {}
    for number in range(identity.count):
        if progress is not None:
            progress("hash", number, identity.count)
        problems: list[str] = []
        if number not in present:
            problems.append("is missing; run the data set again")
        elif rows is not None and number not in rows:
            problems.append(f"is not in the catalogue; {describe_remedy(places)}")
        if number in present:
            record = _check_sample(places, sampler, number, checked, problems)
            if record is not None:
                records[number] = record
                problems += _unlike_row(record, sampler, (rows or {}).get(number))
        found += [VerificationFailure(number, problem) for problem in problems]
    found += _check_results(places, checked)
    if progress is not None:
        progress("hash", identity.count, identity.count)
    chosen = _some(records, regenerate, seed)
    for done, number in enumerate(chosen):
        if progress is not None:
            progress("regenerate", done, len(chosen))
        for problem in _differs(sampler, identity, number, records[number]):
            found.append(VerificationFailure(number, problem))
    if progress is not None:
        progress("regenerate", len(chosen), len(chosen))
    return sorted(found, key=lambda one: (one.number is not None, one.number or 0))


def _check_lists(places: DatasetFolder) -> list[VerificationFailure]:
    """Return the files of the data set, its catalogue and its card that do not match the lists of checksums."""
    remedies = {
        list_path(places.identity): "restore it from a copy, or generate the data set again",
        list_path(places.catalogue): describe_remedy(places),
        list_path(places.card): f"write the card again: scenetruth dataset card {places.path} --overwrite",
    }
    found = []
    for listed, files in places.checksums.items():
        for name, problem in check_listed(listed, list(files), remedies[listed]):
            found.append(VerificationFailure(None, problem, name))
    for part in list_parts(places):
        for name, problem in check_listed(list_path(part), [part], describe_remedy(places)):
            found.append(VerificationFailure(None, problem, f"{places.parts.name}/{name}"))
    return found


def _read_rows(
    places: DatasetFolder, sampler: Sampler, found: list[VerificationFailure]
) -> dict[int, dict[str, Any]] | None:
    """Return the rows of the catalogue by sample; None if it is damaged."""
    try:
        return {row["sample"]: row for row in read_catalogue(places, sampler).to_pylist()}
    except StoreError as error:
        if not any(one.file.startswith(places.parts.name) for one in found):
            found.append(VerificationFailure(None, error.message, places.catalogue.name))
        return None


@contextmanager
def _files_of(places: DatasetFolder, sampler: Sampler, number: int) -> Iterator[Path]:
    """Yield a directory with the files of a sample."""
    shard = places.shard(compute_shard_number(number, sampler.recipe.samples_per_shard))
    with extract_sample(shard, number) if shard.exists() else nullcontext(places.sample(number)) as files:
        yield files


def _check_sample(
    places: DatasetFolder, sampler: Sampler, number: int, checked: bool, problems: list[str]
) -> dict[str, Any] | None:
    """Return the record of a sample, None if it is damaged, and add the problems of record and files."""
    try:
        with _files_of(places, sampler, number) as files:
            record = _read_record(files, sampler, number, checked, problems)
            problems += _unlike_files(files, record)
            problems += _damaged_estimates(files)
            problems += _unlike_scores(files, checked)
            return record
    except ScenetruthError as error:
        problems.append(str(error))
        return None


def _read_record(
    files: Path, sampler: Sampler, number: int, checked: bool, problems: list[str]
) -> dict[str, Any] | None:
    """Return the record of a sample, None if it is damaged, and add its problems."""
    try:
        record = load_record((files / SAMPLE).read_bytes(), required=checked)
        build_catalogue_table([record], sampler)
    except OSError as error:
        problems.append(f"{SAMPLE} cannot be read: {error.strerror}; {_AGAIN}")
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        problems.append(f"{SAMPLE} is damaged: {error}; {_AGAIN}")
        return None
    if record["sample"] != number:
        problems.append(f"{SAMPLE} is that of sample {record['sample']}; {_AGAIN}")
        return None
    return record


def _unlike_files(folder: Path, record: Mapping[str, Any] | None) -> Iterator[str]:
    for file in FILES:
        try:
            found = file_sha256(folder / file)
        except OSError as error:
            yield f"{file} cannot be read: {error.strerror}; {_AGAIN}"
            continue
        if record is not None and found != record["files"][file]["sha256"]:
            yield f"{file} has changed; {_AGAIN}"


def _damaged_estimates(folder: Path) -> Iterator[str]:
    for estimate in RunDirectory(folder).stores("estimate*"):
        try:
            verify_store(estimate)
        except StoreError as error:
            yield f"{estimate.name} {error.message}; remove it, and estimate again"


def _unlike_scores(folder: Path, checked: bool) -> Iterator[str]:
    """Yield the problems of the files of scores in the directory of a sample."""
    tables = sorted(file for suffix in ("json", "csv") for file in folder.glob(f"score*.{suffix}"))
    for listed in sorted({*map(list_path, tables), *folder.glob("score*.sha256")}):
        if checked or listed.exists():
            files = [file for file in tables if list_path(file) == listed]
            for name, problem in check_listed(listed, files, _SCORE_AGAIN):
                yield f"{name} {problem}"


def _unlike_row(record: Mapping[str, Any], sampler: Sampler, row: Mapping[str, Any] | None) -> list[str]:
    """Return the columns of the catalogue that differ from the record; run times are in the catalogue only."""
    if row is None:
        return []
    (own,) = build_catalogue_table([record], sampler).to_pylist()
    unlike = [name for name, value in own.items() if name != "seconds" and value != row[name]]
    if not unlike:
        return []
    more = f" and {len(unlike) - _MOST_NAMED} more" if len(unlike) > _MOST_NAMED else ""
    return [f"{SAMPLE} and the catalogue differ in {', '.join(unlike[:_MOST_NAMED])}{more}; {_REBUILD}"]


_MOST_NAMED = 5
_REBUILD = "rebuild the catalogue by `scenetruth dataset catalogue`"


def _check_results(places: DatasetFolder, checked: bool) -> Iterator[VerificationFailure]:
    """Yield the damaged tables and records of scores, and records of failures."""
    for method in places.scored():
        table = places.scores_table(method)
        listed = list_path(table)
        within = f"scores/{method}/"
        if checked or listed.exists():
            for name, problem in check_listed(listed, [table], SCORES_REMEDY):
                yield VerificationFailure(None, problem, within + name)
        for file in sorted(places.scores(method).glob("*/*.json")):
            name = within + file.relative_to(places.scores(method)).as_posix()
            yield from _check_record(file, name, checked, "remove it, and estimate again")
    for number in places.failures():
        file = places.failure(number)
        name = f"{places.failed.name}/{file.name}"
        yield from _check_record(file, name, checked, "run the data set again")


def _check_record(file: Path, name: str, checked: bool, remedy: str) -> Iterator[VerificationFailure]:
    try:
        load_record(file.read_bytes(), required=checked)
    except (OSError, ValueError, TypeError) as error:
        yield VerificationFailure(None, f"is damaged: {error}; {remedy}", name)


def _some(numbers: Iterable[int], count: int, seed: int) -> list[int]:
    every = sorted(numbers)
    if not every:
        return []
    chosen = generator_for(seed, "verify").choice(every, min(count, len(every)), replace=False)
    return sorted(int(number) for number in chosen)


def _differs(sampler: Sampler, identity: DatasetFingerprint, number: int, record: Mapping[str, Any]) -> list[str]:
    with TemporaryDirectory(prefix="scenetruth-") as scratch:
        try:
            made = make_sample(sampler, identity, number, Path(scratch) / "again")
        except ScenetruthError as error:
            return [f"cannot be regenerated: {error}"]
    return [
        f"{file} differs when regenerated"
        for file in FILES
        if made["files"][file]["sha256"] != record["files"][file]["sha256"]
    ]


def rebuild_catalogue(folder: str | Path, *, progress: Progress | None = None) -> int:
    """Rebuild the catalogue of a data set from the records of its samples, and return their number.

    Run times are kept if the former catalogue matches its checksum; they are in no record. If a record is damaged,
    nothing is written, and all damaged records are listed.
    """
    require_parquet()
    places = DatasetFolder(folder)
    identity, sampler = read_fingerprint(places), open_sampler(places)
    store = SampleStore.of(places, sampler, identity)
    with lock_output(places.path / "run-1of1"):
        present = store.present(range(identity.count))
        store.refuse_empty(present)
        former = _read_rows(places, sampler, []) or {}
        rows: list[dict[str, Any]] = []
        damaged: list[str] = []
        for done, number in enumerate(sorted(present)):
            if progress is not None:
                progress("samples", done, len(present))
            problems: list[str] = []
            with _files_of(places, sampler, number) as files:
                record = _read_record(files, sampler, number, identity.format >= CHECKED_FORMAT, problems)
            damaged += [f"sample {number}: {problem}" for problem in problems]
            if record is not None:
                rows.append({**record, "seconds": former.get(number, {}).get("seconds")})
        if progress is not None:
            progress("samples", len(present), len(present))
        if damaged:
            more = [f"and {len(damaged) - _MOST_LISTED:,} more"] if len(damaged) > _MOST_LISTED else []
            text = "\n  ".join([*damaged[:_MOST_LISTED], *more])
            raise StoreError(places.samples, f"has damaged records, and no catalogue was written:\n  {text}")
        table = build_catalogue_table(rows, sampler)
        replace_catalogue(places, table, complete=len(rows) == identity.count)
    return len(rows)


_MOST_LISTED = 20

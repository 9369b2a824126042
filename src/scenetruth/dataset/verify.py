"""Whether a data set is as it was made: every file hashed again, and a few samples made again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenetruth.dataset.catalogue.columns import FILES
from scenetruth.dataset.catalogue.store import read_catalogue
from scenetruth.dataset.folder import SAMPLE, DatasetFolder
from scenetruth.dataset.identity import Identity, open_sampler, read_identity
from scenetruth.dataset.sample import make_sample
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.shards import extracted, shard_of
from scenetruth.errors import ScenetruthError, StoreError
from scenetruth.progress import Progress
from scenetruth.randomness import generator_for

__all__ = ["Damage", "verify_dataset"]


@dataclass(frozen=True)
class Damage:
    """A sample that is not as it was made.

    Parameters
    ----------
    number
        Its number.
    problem
        What is wrong.
    """

    number: int
    problem: str


def verify_dataset(
    folder: str | Path, *, again: int = 3, seed: int = 0, progress: Progress | None = None
) -> list[Damage]:
    """Hash every file of a data set, and make a few samples again, to the same bytes.

    Parameters
    ----------
    folder
        The data set.
    again
        How many samples, drawn at random, are made again.
    seed
        Seed of that draw.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of Damage
        What is wrong; samples that are missing count. Empty if nothing is.

    Raises
    ------
    StoreError
        If there is no data set, or its catalogue is damaged.
    """
    places = DatasetFolder(folder)
    identity, sampler = read_identity(places), open_sampler(places)
    rows = {row["sample"]: row for row in read_catalogue(places, sampler).to_pylist()}
    found = [
        Damage(number, "is not in the catalogue: it was never made, or its run was killed")
        for number in range(identity.count)
        if number not in rows
    ]
    for done, (number, row) in enumerate(rows.items()):
        if progress is not None:
            progress("hash", done, len(rows))
        try:
            found += [Damage(number, problem) for problem in _changed(places, sampler, number, row)]
        except ScenetruthError as error:
            found.append(Damage(number, str(error)))
    if progress is not None:
        progress("hash", len(rows), len(rows))
    chosen = _some(rows, again, seed)
    for done, number in enumerate(chosen):
        if progress is not None:
            progress("make again", done, len(chosen))
        found += [Damage(number, problem) for problem in _differs(sampler, identity, number, rows[number])]
    if progress is not None:
        progress("make again", len(chosen), len(chosen))
    return sorted(found, key=lambda one: one.number)


def _some(numbers: Iterable[int], count: int, seed: int) -> list[int]:
    every = sorted(numbers)
    if not every:
        return []
    chosen = generator_for(seed, "verify").choice(every, min(count, len(every)), replace=False)
    return sorted(int(number) for number in chosen)


def _changed(places: DatasetFolder, sampler: Sampler, number: int, row: dict[str, Any]) -> list[str]:
    """Return which files of a sample are not those of the catalogue."""
    shard = places.shard(shard_of(number, sampler.recipe.samples_per_shard))
    if shard.exists():
        with extracted(shard, number) as files:
            return _unlike(files, row)
    own = places.sample(number)
    return _unlike(own, row) if own.is_dir() else ["is missing; run the data set again"]


def _unlike(folder: Path, row: dict[str, Any]) -> list[str]:
    problems = []
    for file, name in FILES.items():
        path = folder / file
        try:
            with path.open("rb") as stream:
                found = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            problems.append(f"{file} cannot be read: {error.strerror}; remove the sample, and run the data set again")
            continue
        if found != row[f"{name}_sha256"]:
            problems.append(f"{file} is not as it was made; remove the sample, and run the data set again")
    if not (folder / SAMPLE).is_file():
        problems.append(f"{SAMPLE} is missing; remove the sample, and run the data set again")
    return problems


def _differs(sampler: Sampler, identity: Identity, number: int, row: dict[str, Any]) -> list[str]:
    """Return what differs if a sample is made again."""
    with TemporaryDirectory(prefix="scenetruth-") as scratch:
        try:
            made = make_sample(sampler, identity, number, Path(scratch) / "again")
        except (StoreError, ScenetruthError) as error:
            return [f"cannot be made again: {error}"]
    return [
        f"{file} has other bytes when it is made again"
        for file, name in FILES.items()
        if made["files"][file]["sha256"] != row[f"{name}_sha256"]
    ]

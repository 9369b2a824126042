"""The folder of a data set: names of files and folders, and shards that hold many samples."""

from __future__ import annotations

import os
import re
import shutil
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenetruth.errors import StoreError
from scenetruth.output import OwnershipResult, write_atomically
from scenetruth.plain_data import parse_json

__all__ = [
    "RECORDING",
    "SAMPLE",
    "SCENE",
    "TRUTH",
    "DatasetFolder",
    "claim_sample",
    "compute_shard_number",
    "extract_sample",
    "list_shard_samples",
    "pack_shard",
    "read_shard_records",
]


_PER_GROUP = 1000
_NAME = re.compile(r"[0-9]{8}")
SAMPLE, SCENE, RECORDING, TRUTH = "sample.json", "scene.yaml", "recording.zarr.zip", "truth.zarr.zip"
"""Files of a sample."""


class DatasetFolder:
    """The folder of a data set.

    Samples lie a thousand to a folder, each with a number of eight digits: ``samples/00000/00000417``. The folder of a
    sample is that of a run (`scenetruth.RunDirectory`) with zip files as stores, and a ``sample.json`` that says what
    was drawn and what came of it.

    ``path``: The folder; it need not exist.

    >>> DatasetFolder("outputs/leaves").sample(1417).relative_to("outputs").as_posix()
    'leaves/samples/00001/00001417'
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def __repr__(self) -> str:
        return f"DatasetFolder({str(self.path)!r})"

    @property
    def recipe(self) -> Path:
        """The recipe with its base scenes in it."""
        return self.path / "dataset.yaml"

    @property
    def identity(self) -> Path:
        """What the data set is: hash of the recipe, backend, versions."""
        return self.path / "dataset.json"

    @property
    def samples(self) -> Path:
        """The samples, layout ``folder``."""
        return self.path / "samples"

    @property
    def shards(self) -> Path:
        """The tar files, layout ``shards``."""
        return self.path / "shards"

    @property
    def catalogue(self) -> Path:
        """The catalogue, one row per sample, when it is whole."""
        return self.path / "catalogue.parquet"

    @property
    def parts(self) -> Path:
        """Parts of the catalogue, as they are written."""
        return self.path / "catalogue"

    @property
    def failed(self) -> Path:
        """What went wrong, one file per sample that was set aside."""
        return self.path / "failed"

    def scores(self, method: str) -> Path:
        """Return the folder of a method's scores, one file for each sample."""
        # A plain function is named module:function.
        return self.path / "scores" / re.sub(r"[^\w-]", "-", method)

    def scores_table(self, method: str) -> Path:
        """Return the table of a method's scores, one row for each sample."""
        return self.scores(method) / "scores.parquet"

    def scored(self) -> list[str]:
        """Return the names of the methods that have scores."""
        return sorted(name for name in _names(self.path / "scores") if not name.startswith("."))

    @property
    def card(self) -> Path:
        """What it is, for people."""
        return self.path / "card.html"

    @property
    def card_text(self) -> Path:
        """The same as Markdown."""
        return self.path / "card.md"

    @property
    def card_pictures(self) -> Path:
        """Pictures of the card."""
        return self.path / "card"

    @property
    def croissant(self) -> Path:
        """What it is, for machines."""
        return self.path / "croissant.json"

    def sample(self, number: int) -> Path:
        """Return the folder of a sample."""
        return self.samples / f"{number // _PER_GROUP:05d}" / f"{number:08d}"

    def shard(self, number: int) -> Path:
        """Return a tar file."""
        return self.shards / f"{number:08d}.tar"

    def failure(self, number: int) -> Path:
        """Return the file that tells why a sample failed."""
        return self.failed / f"{number:08d}.json"

    def done(self) -> Iterator[int]:
        """Yield the numbers of the samples that lie in folders, in no order: what has its name is whole."""
        for group in _names(self.samples):
            yield from (int(name) for name in _names(self.samples / group) if _NAME.fullmatch(name))

    def done_shards(self) -> Iterator[int]:
        """Yield the numbers of the tar files."""
        yield from (int(name[:-4]) for name in _names(self.shards) if re.fullmatch(r"[0-9]{8}\.tar", name))

    def failures(self) -> list[int]:
        """Return the numbers of the samples that failed, in order."""
        return sorted(int(name[:-5]) for name in _names(self.failed) if re.fullmatch(r"[0-9]{8}\.json", name))

    def groups_with_leftovers(self) -> Iterator[Path]:
        """Yield the folders in which a writer that was killed may have left something."""
        folders = [self.path, self.samples, self.shards, self.failed, self.parts]
        for folder in [*folders, *(self.samples / group for group in _names(self.samples))]:
            if any(name.startswith(".") for name in _names(folder)):
                yield folder


def _names(folder: Path) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return [entry.name for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return []


def claim_sample(path: Path) -> OwnershipResult:
    """Claim the folder of a sample."""
    if path.is_dir() and (path / SAMPLE).is_file():
        return OwnershipResult()
    return OwnershipResult("is no sample that scenetruth wrote")


_FILES = (SAMPLE, SCENE, RECORDING, TRUTH)


def compute_shard_number(number: int, per_shard: int) -> int:
    """Return the number of the shard that a sample belongs to."""
    return number // per_shard


def list_shard_samples(shard: int, per_shard: int, count: int) -> range:
    """Return the numbers of the samples of a shard, of so many in all."""
    return range(shard * per_shard, min((shard + 1) * per_shard, count))


def pack_shard(folder: DatasetFolder, shard: int, numbers: range) -> None:
    """Put samples into one tar file, the same bytes each time, and remove their folders."""
    target = folder.shard(shard)
    if not target.exists():
        with write_atomically(target) as aside, tarfile.open(aside, "w", format=tarfile.USTAR_FORMAT) as archive:
            for number in numbers:
                for name in _FILES:
                    _add(archive, folder.sample(number) / name, f"{number:08d}.{name}")
    for number in numbers:
        # What is whole in the tar file is not needed twice; a sample loses what makes it one first.
        (folder.sample(number) / SAMPLE).unlink(missing_ok=True)
        shutil.rmtree(folder.sample(number), ignore_errors=True)


def _add(archive: tarfile.TarFile, file: Path, name: str) -> None:
    entry = tarfile.TarInfo(name)
    entry.size, entry.mode = file.stat().st_size, 0o644
    with file.open("rb") as stream:
        archive.addfile(entry, stream)


def read_shard_records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield what ``sample.json`` says of every sample of a tar file."""
    try:
        with tarfile.open(path, "r:") as archive:
            for entry in archive:
                if entry.name.endswith(f".{SAMPLE}"):
                    stream = archive.extractfile(entry)
                    if stream is not None:
                        yield dict(parse_json(stream.read()))
    except (OSError, ValueError, tarfile.TarError) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and run the data set again") from error


@contextmanager
def extract_sample(path: Path, number: int) -> Iterator[Path]:
    """Give a folder with the files of one sample of a tar file; it vanishes when the block ends."""
    wanted = {f"{number:08d}.{name}": name for name in _FILES}
    with TemporaryDirectory(prefix="scenetruth-") as scratch:
        found = 0
        try:
            with tarfile.open(path, "r:") as archive:
                for entry in archive:
                    stream = archive.extractfile(entry) if entry.name in wanted else None
                    if stream is not None:
                        with (Path(scratch) / wanted[entry.name]).open("wb") as out:
                            shutil.copyfileobj(stream, out)
                        found += 1
                    if found == len(wanted):
                        break
        except (OSError, tarfile.TarError) as error:
            raise StoreError(path, f"cannot be read: {error}") from error
        if found < len(wanted):
            raise StoreError(path, f"does not hold sample {number}")
        yield Path(scratch)

"""Directory layout of a data set: names of files and directories, and shards of many samples."""

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

from scenetruth.dataset.checksums import list_path, load_record
from scenetruth.errors import StoreError
from scenetruth.output import OwnershipResult, write_atomically

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


class DatasetFolder:
    """Directory layout of a data set; the directory need not exist.

    Directories of samples are grouped by the thousand, with eight-digit names: ``samples/00000/00000417``. The
    directory of a sample is a run directory (`scenetruth.RunDirectory`) with zip stores and a ``sample.json`` of drawn
    values and results.

    >>> DatasetFolder("outputs/leaves").sample(1417).relative_to("outputs").as_posix()
    'leaves/samples/00001/00001417'
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def __repr__(self) -> str:
        return f"DatasetFolder({str(self.path)!r})"

    @property
    def recipe(self) -> Path:
        """The recipe, including its base scenes."""
        return self.path / "dataset.yaml"

    @property
    def identity(self) -> Path:
        """The fingerprint: hash of the recipe, backend, versions."""
        return self.path / "dataset.json"

    @property
    def samples(self) -> Path:
        """The samples of layout ``folder``."""
        return self.path / "samples"

    @property
    def shards(self) -> Path:
        """The tar files of layout ``shards``."""
        return self.path / "shards"

    @property
    def catalogue(self) -> Path:
        """The complete catalogue, one row per sample."""
        return self.path / "catalogue.parquet"

    @property
    def parts(self) -> Path:
        """Parts of the catalogue during generation."""
        return self.path / "catalogue"

    @property
    def failed(self) -> Path:
        """Errors, one file per failed sample."""
        return self.path / "failed"

    def scores(self, method: str) -> Path:
        """Return the directory of a method's scores, one file per sample."""
        # A plain function is named module:function.
        return self.path / "scores" / re.sub(r"[^\w-]", "-", method)

    def scores_table(self, method: str) -> Path:
        """Return the table of a method's scores, one row per sample."""
        return self.scores(method) / "scores.parquet"

    def scored(self) -> list[str]:
        """Return the names of the methods with scores."""
        return sorted(name for name in _names(self.path / "scores") if not name.startswith("."))

    @property
    def card(self) -> Path:
        """The card as HTML."""
        return self.path / "card.html"

    @property
    def card_text(self) -> Path:
        """The card as Markdown."""
        return self.path / "card.md"

    @property
    def card_pictures(self) -> Path:
        """Directory of the figures of the card."""
        return self.path / "card"

    @property
    def croissant(self) -> Path:
        """The Croissant metadata."""
        return self.path / "croissant.json"

    @property
    def checksums(self) -> dict[Path, tuple[Path, ...]]:
        """The lists of checksums, and the files of each, without those of parts and scores."""
        return {
            list_path(self.identity): (self.recipe, self.identity),
            list_path(self.catalogue): (self.catalogue,),
            list_path(self.card): (self.card_text, self.card, self.croissant),
        }

    def sample(self, number: int) -> Path:
        """Return the directory of a sample."""
        return self.samples / f"{number // _PER_GROUP:05d}" / f"{number:08d}"

    def shard(self, number: int) -> Path:
        """Return the tar file of a shard."""
        return self.shards / f"{number:08d}.tar"

    def failure(self, number: int) -> Path:
        """Return the error file of a failed sample."""
        return self.failed / f"{number:08d}.json"

    def done(self) -> Iterator[int]:
        """Yield the numbers of the samples in directories, unordered; writes are atomic, so all are complete."""
        for group in _names(self.samples):
            yield from (int(name) for name in _names(self.samples / group) if _NAME.fullmatch(name))

    def done_shards(self) -> Iterator[int]:
        """Yield the numbers of the shards."""
        yield from (int(name[:-4]) for name in _names(self.shards) if re.fullmatch(r"[0-9]{8}\.tar", name))

    def failures(self) -> list[int]:
        """Return the numbers of the failed samples in order."""
        return sorted(int(name[:-5]) for name in _names(self.failed) if re.fullmatch(r"[0-9]{8}\.json", name))

    def groups_with_leftovers(self) -> Iterator[Path]:
        """Yield the directories that may contain incomplete output of an interrupted run."""
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
    """Claim the directory of a sample."""
    if path.is_dir() and (path / SAMPLE).is_file():
        return OwnershipResult()
    return OwnershipResult("is not a sample written by scenetruth")


_FILES = (SAMPLE, SCENE, RECORDING, TRUTH)


def compute_shard_number(number: int, per_shard: int) -> int:
    """Return the number of the shard of a sample."""
    return number // per_shard


def list_shard_samples(shard: int, per_shard: int, count: int) -> range:
    """Return the sample numbers of a shard, for ``count`` samples in total."""
    return range(shard * per_shard, min((shard + 1) * per_shard, count))


def pack_shard(folder: DatasetFolder, shard: int, numbers: range) -> None:
    """Pack samples into one tar file with reproducible bytes, and remove their directories."""
    target = folder.shard(shard)
    if not target.exists():
        with write_atomically(target) as partial, tarfile.open(partial, "w", format=tarfile.USTAR_FORMAT) as archive:
            for number in numbers:
                for name in _FILES:
                    _add(archive, folder.sample(number) / name, f"{number:08d}.{name}")
    for number in numbers:
        # Directories are redundant once the tar file is complete; sample.json is removed first.
        (folder.sample(number) / SAMPLE).unlink(missing_ok=True)
        shutil.rmtree(folder.sample(number), ignore_errors=True)


def _add(archive: tarfile.TarFile, file: Path, name: str) -> None:
    entry = tarfile.TarInfo(name)
    entry.size, entry.mode = file.stat().st_size, 0o644
    with file.open("rb") as stream:
        archive.addfile(entry, stream)


def read_shard_records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the contents of ``sample.json`` of every sample of a shard."""
    try:
        with tarfile.open(path, "r:") as archive:
            for entry in archive:
                if entry.name.endswith(f".{SAMPLE}"):
                    stream = archive.extractfile(entry)
                    if stream is not None:
                        yield load_record(stream.read())
    except (OSError, ValueError, tarfile.TarError) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and run the data set again") from error


@contextmanager
def extract_sample(path: Path, number: int) -> Iterator[Path]:
    """Yield a temporary directory with the files of one sample of a shard."""
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
            message = f"does not contain all files of sample {number}"
            raise StoreError(path, f"{message}; `scenetruth verify` lists damaged files with their remedy")
        yield Path(scratch)

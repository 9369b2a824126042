"""Samples in tar files, so many in each, named as WebDataset names them: ``00000417.recording.zarr.zip``."""

from __future__ import annotations

import shutil
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenetruth.dataset.folder import RECORDING, SAMPLE, SCENE, TRUTH, DatasetFolder
from scenetruth.errors import StoreError
from scenetruth.placing import write_aside
from scenetruth.plain import parse_json

__all__ = ["extracted", "numbers_of_shard", "pack_shard", "rows_of_shard", "shard_of"]

_FILES = (SAMPLE, SCENE, RECORDING, TRUTH)


def shard_of(number: int, per_shard: int) -> int:
    """Return the number of the shard that a sample belongs to."""
    return number // per_shard


def numbers_of_shard(shard: int, per_shard: int, count: int) -> range:
    """Return the numbers of the samples of a shard, of so many in all."""
    return range(shard * per_shard, min((shard + 1) * per_shard, count))


def pack_shard(folder: DatasetFolder, shard: int, numbers: range) -> None:
    """Put samples into one tar file, the same bytes each time, and remove their folders.

    Parameters
    ----------
    folder
        The data set.
    shard
        Number of the tar file.
    numbers
        The samples; all of them lie in folders.
    """
    target = folder.shard(shard)
    if not target.exists():
        with write_aside(target) as aside, tarfile.open(aside, "w", format=tarfile.USTAR_FORMAT) as archive:
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


def rows_of_shard(path: Path) -> Iterator[dict[str, Any]]:
    """Yield what ``sample.json`` says of every sample of a tar file.

    Raises
    ------
    StoreError
        If the file is damaged.
    """
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
def extracted(path: Path, number: int) -> Iterator[Path]:
    """Give a folder with the files of one sample of a tar file; it vanishes when the block ends.

    Raises
    ------
    StoreError
        If the tar file does not hold it, or is damaged.
    """
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

"""Where samples are: each in its folder, or many in a tar file as soon as all of them are there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.identity import Identity
from scenetruth.dataset.part import Part
from scenetruth.dataset.sample import read_sample
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.shards import numbers_of_shard, pack_shard, rows_of_shard, shard_of

__all__ = ["Shelf"]


@dataclass(frozen=True)
class Shelf:
    """The samples of a data set, wherever they lie.

    Parameters
    ----------
    folder
        The data set.
    count
        How many samples it has when it is whole.
    per_shard
        Samples in a tar file; 0 if each has a folder of its own.
    """

    folder: DatasetFolder
    count: int
    per_shard: int

    @staticmethod
    def of(folder: DatasetFolder, sampler: Sampler, identity: Identity) -> Shelf:
        """Return the samples of a data set."""
        per_shard = sampler.recipe.samples_per_shard if sampler.recipe.layout == "shards" else 0
        return Shelf(folder, identity.count, per_shard)

    def numbers(self, part: Part) -> range:
        """Return the numbers of the samples of a part; those of a tar file stay together."""
        return part.numbers(self.count, max(self.per_shard, 1))

    def present(self, among: range) -> set[int]:
        """Return the numbers of the samples that are there."""
        found = {number for number in self.folder.done() if number in among}
        if self.per_shard:
            for shard in self.folder.done_shards():
                found.update(number for number in self._in_shard(shard) if number in among)
        return found

    def rows(self, numbers: Iterable[int]) -> Iterator[dict[str, Any]]:
        """Yield what ``sample.json`` says of some samples, in order."""
        wanted = sorted(numbers)
        packed: dict[int, dict[str, Any]] = {}
        for number in wanted:
            path = self.folder.shard(shard_of(number, self.per_shard)) if self.per_shard else None
            if path is None or not path.exists():
                yield read_sample(self.folder.sample(number))
                continue
            if number not in packed:
                packed = {row["sample"]: row for row in rows_of_shard(path)}
            yield packed[number]

    def pack(self, among: range) -> None:
        """Put samples into tar files where all of one are there, and finish what a run that was killed had begun."""
        if not self.per_shard:
            return
        lying = {number for number in self.folder.done() if number in among}
        for shard in sorted({shard_of(number, self.per_shard) for number in lying}):
            numbers = self._in_shard(shard)
            if self.folder.shard(shard).exists() or lying.issuperset(numbers):
                pack_shard(self.folder, shard, numbers)

    def added(self, number: int) -> None:
        """Put the samples of a tar file into it if a new one was the last that it waited for."""
        if self.per_shard:
            shard = shard_of(number, self.per_shard)
            if all(self.folder.sample(one).is_dir() for one in self._in_shard(shard)):
                pack_shard(self.folder, shard, self._in_shard(shard))

    def _in_shard(self, shard: int) -> range:
        return numbers_of_shard(shard, self.per_shard, self.count)

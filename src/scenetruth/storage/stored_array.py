"""A variable of a store that xarray reads on access."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scenetruth.errors import StoreError
from scenetruth.storage.array_layout import ArrayLayout, ShardReader, describe_damage
from scenetruth.storage.store_files import open_store_files

__all__ = ["StoredArray"]


class StoredArray(BackendArray):
    """One variable of a store, read on access."""

    def __init__(self, path: Path, layout: ArrayLayout) -> None:
        self._path, self._layout = path, layout
        self._shard: ShardReader | None = None
        self.shape, self.dtype = layout.shape, layout.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        """Read the selection of an xarray indexer."""
        support = indexing.IndexingSupport.OUTER
        return np.asarray(indexing.explicit_indexing_adapter(key, self.shape, support, self.read))

    def read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a selection, chunk by chunk, and verify the checksum of each chunk."""
        try:
            return self._select(key)
        except Exception as error:  # codecs raise various exceptions for damage
            raise StoreError(self._path, describe_damage(self._layout.name, error)) from error

    def _select(self, key: Sequence[Any]) -> NDArray[Any]:
        """Return the outer product of an index, a slice or an array of indices for each dimension."""
        layout, shard = self._layout, self._find_shard()
        numbers = [np.arange(size)[index] for size, index in zip(self.shape, key, strict=True)]
        steps = [
            _plan_steps(np.atleast_1d(one), layout.chunks[axis] < self.shape[axis]) for axis, one in enumerate(numbers)
        ]
        found = np.empty([one.size for one in numbers], self.dtype)
        with shard.open() as file:
            for parts in product(*steps):
                at, places, inside = zip(*parts, strict=True)
                chunk = layout.decode(shard.read(file, at))
                for axis, index in enumerate(inside):
                    chunk = chunk[(slice(None),) * axis + (index,)]
                found[places] = chunk
        return found[tuple(0 if one.ndim == 0 else slice(None) for one in numbers)]

    def _find_shard(self) -> ShardReader:
        """Return the file of the chunks, whose chunk index is read once, and again after the store was replaced."""
        if self._shard is None or self._shard.has_changed():
            self._shard = ShardReader(*open_store_files(self._path).locate(self._layout.file), self._layout.grid)
        return self._shard


def _plan_steps(numbers: NDArray[np.intp], split: bool) -> list[tuple[int, slice, Any]]:
    """Return for each chunk along a dimension: its number, its place in the result, and the indices within it."""
    if split:
        return [(int(number), slice(place, place + 1), slice(None)) for place, number in enumerate(numbers)]
    if numbers.size and np.all(np.diff(numbers) == 1):
        return [(0, slice(None), slice(int(numbers[0]), int(numbers[-1]) + 1))]
    return [(0, slice(None), numbers)]

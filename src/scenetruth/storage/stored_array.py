"""A variable of a store that xarray reads on access."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scenetruth.errors import StoreError
from scenetruth.storage.zarr_layout import without_warnings

__all__ = ["StoredArray"]


class StoredArray(BackendArray):
    """One variable of a store, read on access."""

    def __init__(self, path: Path, name: str, array: Any) -> None:
        self._path, self._name, self._array = path, name, array
        self.shape, self.dtype = array.shape, np.dtype(array.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        """Read the selection of an xarray indexer."""
        support = indexing.IndexingSupport.OUTER
        return np.asarray(indexing.explicit_indexing_adapter(key, self.shape, support, self.read))

    def read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a selection and verify the checksum of each chunk read."""
        try:
            with without_warnings():
                return np.asarray(self._array.oindex[tuple(map(_plain, key))] if key else self._array[...])
        except Exception as error:  # zarr and the codecs raise various exceptions for damage
            message = f"is damaged: '{self._name}' cannot be read ({' '.join(str(error).split())}); create it again"
            raise StoreError(self._path, message) from error


def _plain(index: Any) -> Any:
    """Return consecutive indices as a slice, because zarr reads index arrays ten times more slowly."""
    if (
        isinstance(index, np.ndarray)
        and index.ndim == 1
        and index.size
        and np.all(np.diff(index) == 1)
        and index[0] >= 0
    ):
        return slice(int(index[0]), int(index[-1]) + 1)
    return index

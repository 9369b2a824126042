"""Reading of stores, eager or image by image, and verification down to the last chunk."""

from __future__ import annotations

from itertools import product
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scenetruth.errors import RecordingError, StoreError
from scenetruth.schema import FORMAT_VERSION, check_dataset
from scenetruth.storage.store_files import (
    CHECKSUM_ATTRIBUTE,
    ROOT,
    check_checksums,
    differs_from_packed,
    is_zip_name,
    open_store_files,
)
from scenetruth.storage.zarr_layout import AUXILIARY, chunk_shape, is_mapped, without_warnings

__all__ = ["STORE_KINDS", "StoreKind", "load_store", "open_store", "verify_store"]


StoreKind = Literal["recording", "truth", "estimate"]
STORE_KINDS: tuple[StoreKind, ...] = ("recording", "truth", "estimate")
"""What a store can hold."""


def load_store(path: str | Path, kind: StoreKind | None = None) -> xr.Dataset:
    """Read a store that `save` has written.

    Parameters
    ----------
    path
        The store.
    kind
        Kind that the store must hold; any kind if not given.

    Returns
    -------
    xarray.Dataset
        The data set, in memory.

    Raises
    ------
    StoreError
        If there is no such store, it is not ours or of another kind, or it is damaged: every chunk is checked.

    See Also
    --------
    open_store : The same, read as it is needed.
    save_store : Write a store.

    Examples
    --------
    >>> import tempfile
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     st.save_store(recording, f"{folder}/recording.zarr")
    ...     again = load_store(f"{folder}/recording.zarr")
    ...     try:
    ...         load_store(f"{folder}/recording.zarr", "truth")
    ...     except st.StoreError as error:
    ...         print(error.message)
    holds a recording, but a truth is needed
    >>> again.image.dims, again.attrs["baseline_mm"]
    (('s', 't', 'y', 'x'), 5.0)
    """
    return open_store(path, kind).load()


def open_store(path: str | Path, kind: StoreKind | None = None) -> xr.Dataset:
    """Open a store that `save` has written; images and maps are read when they are used.

    Parameters
    ----------
    path
        The store.
    kind
        Kind that the store must hold; any kind if not given.

    Returns
    -------
    xarray.Dataset
        The data set. What is selected from it is read from the store each time; ``.load()`` keeps it in memory.

    Raises
    ------
    StoreError
        If there is no such store, it is not ours or of another kind, or its metadata or files are damaged; if chunks
        are, when they are read.

    See Also
    --------
    load_store : The same, all in memory.

    Examples
    --------
    >>> import tempfile
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     st.save_store(recording, f"{folder}/recording.zarr")
    ...     lazy = open_store(f"{folder}/recording.zarr")
    ...     lazy.image.sel(s=0, t=0).values.shape
    (8, 8)
    """
    import zarr.storage

    path = Path(path)
    attributes = _attributes(path, kind)
    try:
        with without_warnings():
            store = zarr.storage.ZipStore(path, mode="r") if is_zip_name(path) else path
            group = zarr.open_group(store, mode="r", use_consolidated=False)
            arrays = {name: group[name] for name in _names(path)}
            variables = {name: _variable(path, name, array) for name, array in arrays.items()}
    except StoreError:
        raise
    except Exception as error:  # zarr reports a damaged store with errors of many kinds
        raise StoreError(path, f"is damaged ({error}); make it again") from error
    auxiliary = str(attributes.pop(AUXILIARY, "")).split()
    del attributes[CHECKSUM_ATTRIBUTE]
    coords = {name: variable for name, variable in variables.items() if name in auxiliary or variable.dims == (name,)}
    data = {name: variable for name, variable in variables.items() if name not in coords}
    try:
        dataset = xr.Dataset(data, coords, attributes)
        check_dataset(dataset, str(attributes["scenetruth"]))
    except (RecordingError, ValueError) as error:
        raise StoreError(path, f"does not have the agreed form: {error}") from error
    return dataset


def _attributes(path: Path, kind: StoreKind | None) -> dict[str, Any]:
    """Return the attributes of a store that is ours and whole, as far as its metadata tells."""
    import json

    if not path.exists():
        raise StoreError(path, "no such store")
    foreign = "is not a store of scenetruth"
    try:
        attributes = dict(json.loads(open_store_files(path).read(ROOT))["attributes"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise StoreError(path, f"{foreign}, or its metadata is damaged ({error})") from error
    found, version = attributes.get("scenetruth"), attributes.get("format")
    if found not in STORE_KINDS:
        raise StoreError(path, foreign)
    if kind is not None and found != kind:
        raise StoreError(path, f"holds a {found}, but a {kind} is needed")
    if version is None or (isinstance(version, int) and version < FORMAT_VERSION):
        message = f"has the format 1, with other names of variables; this scenetruth reads format {FORMAT_VERSION}: "
        raise StoreError(path, message + "make it again")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        message = f"has the format {version}; this scenetruth reads format {FORMAT_VERSION}: update it"
        raise StoreError(path, message)
    try:
        check_checksums(path, attributes)
    except OSError as error:
        raise StoreError(path, f"is damaged: its files cannot be read ({error}); make it again") from error
    return attributes


def _names(path: Path) -> list[str]:
    found = (PurePosixPath(name) for name in open_store_files(path).sizes())
    return sorted(name.parts[0] for name in found if len(name.parts) == 2 and name.name == ROOT)


def _variable(path: Path, name: str, array: Any) -> xr.Variable:
    dims = array.metadata.dimension_names
    if dims is None:
        raise StoreError(path, f"is damaged: '{name}' has no names of dimensions; make it again")
    stored = StoredArray(path, name, array)
    values = indexing.LazilyIndexedArray(stored) if is_mapped(dims) else stored.read(())
    return xr.Variable(dims, values, dict(array.attrs), fastpath=True)


class StoredArray(BackendArray):
    """The values of one variable in a store, read as they are asked for.

    ``path``: The store, for messages.
    ``name``: The variable.
    ``array``: Its zarr array.
    """

    def __init__(self, path: Path, name: str, array: Any) -> None:
        self._path, self._name, self._array = path, name, array
        self.shape, self.dtype = array.shape, np.dtype(array.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        """Read what a selection of xarray's asks for."""
        support = indexing.IndexingSupport.OUTER
        return np.asarray(indexing.explicit_indexing_adapter(key, self.shape, support, self.read))

    def read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a part; every chunk that is touched is checked."""
        try:
            with without_warnings():
                return np.asarray(self._array.oindex[tuple(map(_plain, key))] if key else self._array[...])
        except Exception as error:  # zarr and the codecs report damage with errors of many kinds
            message = f"is damaged: '{self._name}' cannot be read ({' '.join(str(error).split())}); make it again"
            raise StoreError(self._path, message) from error


def _plain(index: Any) -> Any:
    """Return successive places as a slice: zarr reads lists of places ten times slower."""
    if (
        isinstance(index, np.ndarray)
        and index.ndim == 1
        and index.size
        and np.all(np.diff(index) == 1)
        and index[0] >= 0
    ):
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def verify_store(path: str | Path) -> str:
    """Read a store through, one image or map after the other, and check every byte of it."""
    dataset = open_store(path)
    for variable in dataset.variables.values():
        if not is_mapped(variable.dims):
            continue
        chunks = chunk_shape(variable.dims, variable.shape)
        counts = [size // chunk for size, chunk in zip(variable.shape, chunks, strict=True)]
        for index in product(*(range(count) for count in counts)):
            place = {
                dim: number
                for dim, number, count in zip(variable.dims, index, counts, strict=True)
                if count > 1 or dim not in ("y", "x", "channel")
            }
            variable.isel(place).load()
    if is_zip_name(Path(path)):
        with TemporaryDirectory(prefix="scenetruth-") as scratch:
            if differs_from_packed(Path(path), Path(scratch)):
                raise StoreError(path, "is damaged: the zip file is not as it was written; make it again")
    return str(dataset.attrs["scenetruth"])

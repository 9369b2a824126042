"""Reading and verification of stores."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from scenetruth.errors import RecordingError, StoreError
from scenetruth.lazy_exports import lazy_module
from scenetruth.schema import FORMAT_VERSION, check_dataset, with_indexes
from scenetruth.storage.array_layout import ArrayLayout, describe_damage
from scenetruth.storage.store_files import (
    CHECKSUM_ATTRIBUTE,
    ROOT,
    StoredFiles,
    check_checksums,
    differs_from_packed,
    is_zip_name,
    open_store_files,
)
from scenetruth.storage.zarr_layout import AUXILIARY, chunk_shape, is_mapped

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray
else:
    xr = lazy_module("xarray")

__all__ = ["STORE_KINDS", "StoreKind", "load_store", "open_store", "verify_store"]


StoreKind = Literal["recording", "truth", "estimate", "strain"]
STORE_KINDS: tuple[StoreKind, ...] = ("recording", "truth", "estimate", "strain")
"""Types of data sets that a store can hold."""


def load_store(path: str | Path, *, kind: StoreKind | None = None) -> xr.Dataset:
    """Read a store written by `save_store` into memory.

    Parameters
    ----------
    path
        Path of the store.
    kind
        Required type of data set; default: any.

    Returns
    -------
    xarray.Dataset
        The data set, in memory.

    Raises
    ------
    StoreError
        If the store does not exist, was not written by scenetruth, holds another type of data set or is damaged. The
        checksum of every chunk is verified.

    See Also
    --------
    open_store : Open a store for lazy reading.
    save_store : Write a store.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     again = load_store(f"{folder}/recording.zarr")
    ...     try:
    ...         load_store(f"{folder}/recording.zarr", kind="truth")
    ...     except st.StoreError as error:
    ...         print(error.message)
    holds a recording, but a truth is needed
    >>> again.image.dims, again.attrs["baseline_mm"]
    (('s', 't', 'y', 'x'), 5.0)
    """
    return open_store(path, kind=kind).load()


def open_store(path: str | Path, *, kind: StoreKind | None = None) -> xr.Dataset:
    """Open a store written by `save_store`; images and maps are read on access.

    Parameters
    ----------
    path
        Path of the store.
    kind
        Required type of data set; default: any.

    Returns
    -------
    xarray.Dataset
        The data set. Each selection is read from the store on every access; ``.load()`` keeps it in memory.

    Raises
    ------
    StoreError
        If the store does not exist, was not written by scenetruth, holds another type of data set, or has damaged
        metadata or files. Damaged chunks raise on access.

    See Also
    --------
    load_store : Read a store into memory.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     lazy = open_store(f"{folder}/recording.zarr")
    ...     lazy.image.sel(s=0, t=0).values.shape
    (8, 8)
    """
    path = Path(path)
    files = open_store_files(path)
    attributes, metadata = _read_metadata(path, files, kind)
    try:
        # The checksums apply to this copy of the metadata of the arrays as well.
        arrays = metadata["consolidated_metadata"]["metadata"]
        variables = {name: _variable(path, files, name, arrays[name]) for name in sorted(arrays)}
    except StoreError:
        raise
    except Exception as error:  # damage causes various exceptions
        raise StoreError(path, f"is damaged ({error}); create it again") from error
    auxiliary = str(attributes.pop(AUXILIARY, "")).split()
    del attributes[CHECKSUM_ATTRIBUTE]
    coords = {name: variable for name, variable in variables.items() if name in auxiliary or variable.dims == (name,)}
    data = {name: variable for name, variable in variables.items() if name not in coords}
    try:
        dataset = xr.Dataset(data, with_indexes(coords), attributes)
        check_dataset(dataset, str(attributes["scenetruth"]))
    except (RecordingError, ValueError) as error:
        raise StoreError(path, f"does not follow the data model: {error}") from error
    return dataset


def _read_metadata(path: Path, files: StoredFiles, kind: StoreKind | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return attributes and all metadata of a store after checking its type, format version and checksums."""
    import json

    if not path.exists():
        raise StoreError(path, "no such store")
    foreign = "was not written by scenetruth"
    try:
        root = json.loads(files.read(ROOT))
        attributes = dict(root["attributes"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise StoreError(path, f"{foreign}, or its metadata is damaged ({error})") from error
    found, version = attributes.get("scenetruth"), attributes.get("format")
    if found not in STORE_KINDS:
        raise StoreError(path, foreign)
    if kind is not None and found != kind:
        raise StoreError(path, f"holds a {found}, but a {kind} is needed")
    if version is None or (isinstance(version, int) and version < FORMAT_VERSION):
        message = f"has format 1 with obsolete variable names; this scenetruth version reads format {FORMAT_VERSION}: "
        raise StoreError(path, message + "create the store again")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        message = f"has format {version}; this scenetruth version reads format {FORMAT_VERSION}: update scenetruth"
        raise StoreError(path, message)
    try:
        check_checksums(path, files, attributes)
    except OSError as error:
        raise StoreError(path, f"is damaged: its files cannot be read ({error}); create it again") from error
    return attributes, root


def _variable(path: Path, files: StoredFiles, name: str, metadata: dict[str, Any]) -> xr.Variable:
    layout = ArrayLayout.from_metadata(name, metadata)
    dims = layout.dims
    if dims is None:
        raise StoreError(path, f"is damaged: '{name}' has no dimension names; create it again")
    # Where stores are only written, xarray is not needed.
    from xarray.core.indexing import LazilyIndexedArray

    from scenetruth.storage.stored_array import StoredArray

    if is_mapped(dims):
        values: Any = LazilyIndexedArray(StoredArray(path, layout))
    else:
        values = _read_small(path, files, layout)
    return xr.Variable(dims, values, metadata["attributes"], fastpath=True)


def _read_small(path: Path, files: StoredFiles, layout: ArrayLayout) -> NDArray[Any]:
    try:
        return layout.read_whole(files.read(layout.file) if files.holds(layout.file) else None)
    except Exception as error:  # codecs raise various exceptions for damage
        raise StoreError(path, describe_damage(layout.name, error)) from error


def verify_store(path: str | Path) -> str:
    """Read every image and map of a store, verify all checksums and return the type of the data set."""
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
    if is_zip_name(Path(path)) and differs_from_packed(Path(path)):
        raise StoreError(path, "is damaged: the zip file differs from the one written; create it again")
    return str(dataset.attrs["scenetruth"])

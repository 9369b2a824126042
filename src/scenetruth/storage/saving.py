"""Data sets written to stores."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import xarray as xr

from scenetruth.errors import Problem, RecordingError
from scenetruth.placing import write_aside
from scenetruth.schema import FORMAT_VERSION
from scenetruth.storage.integrity import SEAL
from scenetruth.storage.layout import chunk_shape, is_mapped
from scenetruth.storage.reading import KINDS
from scenetruth.storage.store_claim import claim_store
from scenetruth.storage.store_files import is_zip_name
from scenetruth.storage.store_writer import StoreWriter

__all__ = ["save", "write_store"]


def save(dataset: xr.Dataset, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a recording, a truth or an estimate as a zarr store, one chunk for each image or map.

    Parameters
    ----------
    dataset
        The data set; of one that was opened and not loaded, one image or map after the other is read.
    path
        The store to make: a folder, or one zip file if its name ends so (``recording.zarr.zip``).
    overwrite
        Whether an existing store may be replaced. A folder that is no store of ours, or holds other files, never is.

    Raises
    ------
    OutputExistsError
        If the store exists and may not be replaced.
    RecordingError
        If it is not a recording, truth or estimate that `load` could read again; lists what is wrong.
    StoreError
        If it cannot be written; nothing is left behind then.

    See Also
    --------
    load : Read it again.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(recording, f"{folder}/recording.zarr")
    ...     st.load(f"{folder}/recording.zarr", "recording").equals(recording)
    True
    """
    stamped = _stamped(dataset)
    with write_aside(path, overwrite=overwrite, claim=claim_store) as aside:
        _write(stamped, aside, zipped=is_zip_name(Path(path)))


def write_store(dataset: xr.Dataset, path: Path, *, zipped: bool = False) -> None:
    """Write a data set to a store that does not exist yet; see `save`."""
    _write(_stamped(dataset), path, zipped=zipped)


def _write(dataset: xr.Dataset, path: Path, *, zipped: bool) -> None:
    with StoreWriter(path, dataset, zipped=zipped) as writer:
        for name, item in dataset.data_vars.items():
            if not is_mapped(item.dims):
                continue
            chunks = chunk_shape(item.dims, item.shape)
            leading = [dim for dim, chunk in zip(item.dims, chunks, strict=True) if dim not in ("y", "x", "channel")]
            for index in product(*(range(item.sizes[dim]) for dim in leading)):
                at = dict(zip(map(str, leading), index, strict=True))
                writer.put(str(name), at, item.variable.isel(at).values)


def _stamped(dataset: xr.Dataset) -> xr.Dataset:
    """Return a data set with its kind and format version; arithmetic with xarray may have dropped its attributes.

    Raises
    ------
    RecordingError
        If `load` could not read it.
    """
    kind = dataset.attrs.get("scenetruth")
    if kind is None:
        kind = "recording" if "image" in dataset else "truth" if "mixed" in dataset else "estimate"
    if kind not in KINDS:
        message = f"must be one of {', '.join(KINDS)}"
        raise RecordingError([Problem("attrs.scenetruth", message, kind)], source="data set to save")
    stamped = dataset.assign_attrs(scenetruth=kind, format_version=FORMAT_VERSION)
    stamped.attrs.pop(SEAL, None)
    return stamped

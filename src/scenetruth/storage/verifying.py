"""Stores read through to their last chunk, to know that they are as they were written."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from scenetruth.errors import StoreError
from scenetruth.storage.layout import chunk_shape, is_mapped
from scenetruth.storage.reading import open_store
from scenetruth.storage.store_files import differs_from_packed, is_zip_name

__all__ = ["verify_store"]


def verify_store(path: str | Path) -> str:
    """Read a store through, one image or map after the other, and check every byte of it.

    Parameters
    ----------
    path
        The store.

    Returns
    -------
    str
        What it holds: ``"recording"``, ``"truth"`` or ``"estimate"``.

    Raises
    ------
    StoreError
        If there is no such store, it is not ours, or anything of it is damaged.
    """
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

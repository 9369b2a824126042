"""Writing of stores, incrementally or as a whole data set."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Hashable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import product
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.compilation import thread_count
from scenetruth.errors import Problem, RecordingError
from scenetruth.output import scratch_path, write_atomically
from scenetruth.schema import FORMAT_VERSION, DatasetOutline, blank_map, check_dataset
from scenetruth.schema.outline import OutlineVariable
from scenetruth.storage.reader import STORE_KINDS
from scenetruth.storage.store_files import (
    CHECKSUM_ATTRIBUTE,
    ROOT,
    StagedFiles,
    add_checksums,
    claim_store,
    is_zip_name,
    pack,
)
from scenetruth.storage.zarr_layout import (
    ShardFile,
    chunk_shape,
    is_mapped,
    plain_attributes,
    select_codecs,
    select_encoder,
    with_checksum,
    without_warnings,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["StoreWriter", "save_store", "write_store"]


_THREADS = 2
_PENDING_BYTES = 1 << 26


class StoreWriter:
    """Incremental writer of a store, used as a context manager; the store is complete on exit.

    ``path``: Path of a store that does not exist, as supplied by `write_atomically`.
    ``like``: Data set, or its outline, with the variables, coordinates and attributes of the store. Variables with
      pixel dimensions serve as templates and may be blank maps; other variables are written unless replaced by `put`.
    ``narrow``: Store float64 maps as float32.
    """

    def __init__(
        self, path: Path, like: xr.Dataset | DatasetOutline, *, zipped: bool = False, narrow: bool = False
    ) -> None:
        import zarr

        kind = str(like.attrs.get("scenetruth"))
        if narrow:
            wide = {name: item for name, item in like.data_vars.items() if item.dtype == np.float64}
            maps = {name: item for name, item in wide.items() if is_mapped(item.dims)}
            like = like.assign(
                {name: (item.dims, blank_map(np.float32, item.shape), item.attrs) for name, item in maps.items()}
            )
        self._narrow = narrow
        check_dataset(like, kind)
        attributes = plain_attributes(like)
        self._like, self._kind = like, kind
        self._path, self._zipped = path, zipped
        # The zip file is created from finished files, because checksums cannot be added inside an archive.
        self._chunks = scratch_path(path) if zipped else path
        # Metadata and small variables; removing a directory for each would take longer than writing them.
        self._contents: dict[str, Any] = {}
        self._encoders: dict[Hashable, Any] = {}
        self._files: dict[Hashable, ShardFile] = {}
        self._shards: dict[str, Path] = {}
        self._variables = {name: like.variables[name] for name in like.data_vars if is_mapped(like[name].dims)}
        self._arrays: dict[str, Any] = {}
        self._small: dict[str, NDArray[Any]] = {}
        self._pending: deque[tuple[ShardFile, tuple[int, ...], int, Future[bytes]]] = deque()
        self._pending_bytes = 0
        # With a single thread, chunks are compressed synchronously.
        packers = min(_THREADS, thread_count())
        self._pool = ThreadPoolExecutor(packers, thread_name_prefix="store") if packers > 1 else None
        with without_warnings():
            self._group = group = zarr.create_group(self._contents, zarr_format=3, attributes=attributes[""])
            for name, variable in like.variables.items():
                self._create(group, str(name), variable, attributes[str(name)])

    def _create(
        self, group: Any, name: str, variable: xr.Variable | OutlineVariable, attributes: dict[str, Any]
    ) -> None:
        mapped = name in self._variables
        shape = variable.shape
        chunks = chunk_shape(variable.dims, shape) if mapped else tuple(max(1, size) for size in shape)
        dtype = np.dtype(variable.dtype)
        array = group.create_array(
            name,
            shape=shape,
            dtype=dtype,
            chunks=chunks,
            shards=shape if mapped else None,
            dimension_names=[str(dim) for dim in variable.dims],
            attributes=attributes,
            **select_codecs(name if mapped else "", dtype if mapped else np.dtype(np.int8)),
        )
        if mapped:
            grid = [size // chunk for size, chunk in zip(shape, chunks, strict=True)]
            part = "/".join((name, "c", *("0" for _ in shape)))
            place = self._chunks / (name if self._zipped else part)
            self._files[name], self._shards[part] = ShardFile(place, grid), place
            self._encoders[name] = select_encoder(name, dtype)
        else:
            array[...] = variable.values
            self._arrays[name] = array

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes that become available during writing."""
        self._like = self._like.assign_attrs(attrs)
        check_dataset(self._like, self._kind)
        with without_warnings():
            self._group.update_attributes(plain_attributes(self._like)[""])

    def put(self, name: str, at: Mapping[str, int], values: NDArray[Any]) -> None:
        """Write one or several images or maps at an index of the leading dimensions."""
        if name not in self._variables:
            # Variables without pixel dimensions are small and are written on exit.
            small = self._small.setdefault(name, np.array(self._like[name].values))
            small[tuple(at.get(str(dim), slice(None)) for dim in self._like[name].dims)] = values
            return
        variable, file, encoder = self._variables[name], self._files[name], self._encoders[name]
        chunks = chunk_shape(variable.dims, variable.shape)
        grid = [size // chunk for size, chunk in zip(variable.shape, chunks, strict=True)]
        steps = [[at[str(dim)]] if dim in at else range(count) for dim, count in zip(variable.dims, grid, strict=True)]
        if self._narrow and values.dtype == np.float64:
            values = values.astype(np.float32)
        expected = tuple(size for dim, size in variable.sizes.items() if dim not in at)
        if values.shape != expected or values.dtype != variable.dtype:
            msg = f"{name}: {values.dtype} {values.shape}, expected {variable.dtype} {expected}"
            raise ValueError(msg)
        for index in product(*steps):
            # One index for each remaining dimension that is split into chunks.
            inner = tuple(
                number if chunk == 1 and dim not in ("y", "x", "channel") else slice(None)
                for dim, number, chunk in zip(variable.dims, index, chunks, strict=True)
                if dim not in at
            )
            chunk = np.ascontiguousarray(values[inner])
            self._pending.append((file, index, chunk.nbytes, self._packed(encoder, chunk)))
            self._pending_bytes += chunk.nbytes
            self._write_out(_PENDING_BYTES)

    def _packed(self, encoder: Any, chunk: NDArray[Any]) -> Future[bytes]:
        if self._pool is not None:
            return self._pool.submit(_pack, encoder, chunk)
        done: Future[bytes] = Future()
        done.set_result(_pack(encoder, chunk))
        return done

    def _write_out(self, at_most: int) -> None:
        """Append compressed chunks to their files in the order of the calls."""
        while self._pending and (self._pending_bytes > at_most or self._pending[0][3].done()):
            file, index, size, packed = self._pending.popleft()
            self._pending_bytes -= size
            file.put(index, packed.result())

    def _finish(self) -> None:
        import zarr

        self._write_out(-1)
        for name, file in self._files.items():
            if file.missing:
                msg = f"{name}: {file.missing} chunks were not written"
                raise ValueError(msg)
            file.close()
        for name, values in self._small.items():
            self._arrays[name][...] = values
        with without_warnings():
            # Without consolidated metadata, xarray warns when it opens the store.
            zarr.consolidate_metadata(self._group.store, zarr_format=3)
        parts = {**{part: content.to_bytes() for part, content in self._contents.items()}, **self._shards}
        parts[ROOT] = add_checksums(StagedFiles(parts))
        if self._zipped:
            pack(StagedFiles(parts), self._path)
        else:
            StagedFiles(parts).save(self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            if self._pool is not None:
                self._pool.shutdown(wait=True, cancel_futures=True)
            for file in self._files.values():
                file.give_up()
            if self._zipped:
                shutil.rmtree(self._chunks, ignore_errors=True)


def _pack(encoder: Any, chunk: NDArray[Any]) -> bytes:
    return with_checksum(bytes(encoder.encode(chunk)))


def save_store(dataset: xr.Dataset, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a recording, ground truth or estimate to a Zarr store, one chunk per image or map.

    Parameters
    ----------
    dataset
        The data set. A lazily opened data set is copied image by image.
    path
        Path of the store: a directory, or a zip file if the name ends in ``.zip`` (``recording.zarr.zip``).
    overwrite
        Replace an existing store. Directories that are not a store of scenetruth or contain foreign files are never
        replaced.

    Returns
    -------
    pathlib.Path
        The store.

    Raises
    ------
    OutputExistsError
        If the store exists and may not be replaced.
    RecordingError
        If the data set is not a valid recording, ground truth or estimate; lists every problem.
    StoreError
        If the store cannot be written; no partial output remains.

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
    ...     _ = save_store(recording, f"{folder}/recording.zarr")
    ...     st.load_store(f"{folder}/recording.zarr", kind="recording").equals(recording)
    True
    """
    stamped = _stamped(dataset)
    with write_atomically(path, overwrite=overwrite, claim=claim_store) as partial:
        _write(stamped, partial, zipped=is_zip_name(Path(path)))
    return Path(path)


def write_store(dataset: xr.Dataset, path: Path, *, zipped: bool = False) -> None:
    """Write a data set to a store that does not exist, see `save_store`."""
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
    """Return a data set with its type and format version, which xarray arithmetic may have dropped."""
    kind = dataset.attrs.get("scenetruth")
    if kind is None:
        kind = "recording" if "image" in dataset else "truth" if "mixed" in dataset else "estimate"
    if kind not in STORE_KINDS:
        message = f"must be one of {', '.join(STORE_KINDS)}"
        raise RecordingError([Problem("attrs.scenetruth", message, kind)], source="data set to save")
    stamped = dataset.assign_attrs(scenetruth=kind, format=FORMAT_VERSION)
    stamped.attrs.pop(CHECKSUM_ATTRIBUTE, None)
    return stamped

"""Layout of a Zarr store: attributes, chunks, shard files and codecs."""

from __future__ import annotations

import math
import sys
import threading
import warnings
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from scenetruth.errors import Problem, RecordingError
from scenetruth.schema import DatasetOutline

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "ABSENT",
    "AUXILIARY",
    "CHECKSUM_BYTES",
    "ShardFile",
    "chunk_shape",
    "is_mapped",
    "plain_attributes",
    "select_codecs",
    "select_encoder",
    "with_checksum",
    "without_checksum",
    "without_warnings",
]


AUXILIARY = "coordinates"
"""Attribute that lists the non-dimension coordinates, as in the CF conventions and xarray."""


def plain_attributes(dataset: xr.Dataset | DatasetOutline) -> dict[str, dict[str, Any]]:
    """Return the attributes of a data set (key ``""``) and of its variables as JSON values."""
    problems: list[Problem] = []
    found = {"": _plain(dataset.attrs, "attrs", problems)}
    for name, variable in dataset.variables.items():
        found[str(name)] = _plain(variable.attrs, f"{name}.attrs", problems)
        if variable.dtype.kind not in "biufU":
            message = "must hold numbers or text to be stored"
            problems.append(Problem(str(name), message, str(variable.dtype)))
    if problems:
        raise RecordingError(problems, source="data set to save")
    auxiliary = sorted(str(name) for name in dataset.coords if name not in dataset.dims)
    if auxiliary:
        found[""][AUXILIARY] = " ".join(auxiliary)
    return found


def _plain(attrs: Mapping[Any, Any], where: str, problems: list[Problem]) -> dict[str, Any]:
    plain = {}
    for name, value in attrs.items():
        try:
            plain[str(name)] = _plain_value(value)
        except (TypeError, ValueError) as error:
            message = f"cannot be stored: {error}; convert it to text"
            problems.append(Problem(f"{where}.{name}", message, type(value).__name__))
    return plain


def _plain_value(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return _plain_value(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        msg = "JSON does not support NaN or infinity"
        raise ValueError(msg)
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, list | tuple):
        return [_plain_value(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _plain_value(item) for name, item in value.items()}
    msg = f"{type(value).__name__} is not a JSON type"
    raise TypeError(msg)


_STEPPED = frozenset({"boundary_distance"})  # discontinuous float maps, which predictive coding does not compress

_LEVEL = 3  # compression level of zstd; higher levels take twice as long for a few per cent


def is_mapped(dims: Sequence[Hashable]) -> bool:
    """Return whether a variable has pixel dimensions and is therefore stored in chunks."""
    return "y" in dims and "x" in dims


def chunk_shape(dims: Sequence[Hashable], shape: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a chunk: one image or map, including all colour channels."""
    if not is_mapped(dims):
        return tuple(shape)
    return tuple(size if dim in ("y", "x", "channel") else 1 for dim, size in zip(dims, shape, strict=True))


def _is_smooth(name: str, dtype: np.dtype[Any]) -> bool:
    return dtype.kind == "f" and dtype.itemsize in (4, 8) and name not in _STEPPED


def select_encoder(name: str, dtype: np.dtype[Any]) -> Any:
    """Return the numcodecs codec for the chunks of a variable.

    Floats use pcodec, a lossless predictive codec that needs a third of the size of byte shuffling and zstd for exact
    maps of smooth surfaces. All other data use byte shuffling and zstd.
    """
    if _is_smooth(name, dtype):
        from numcodecs.pcodec import PCodec

        return PCodec()
    from numcodecs.blosc import Blosc

    return Blosc("zstd", clevel=_LEVEL, shuffle=Blosc.SHUFFLE, typesize=dtype.itemsize)


def select_codecs(name: str, dtype: np.dtype[Any]) -> dict[str, Any]:
    """Return the zarr configuration of `select_encoder`, followed by a CRC-32C checksum of every chunk."""
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.codecs.numcodecs import PCodec

    if _is_smooth(name, dtype):
        return {"serializer": PCodec(), "compressors": (Crc32cCodec(),)}
    packed = BloscCodec(cname="zstd", clevel=_LEVEL, shuffle="shuffle", typesize=dtype.itemsize)
    return {"compressors": (packed, Crc32cCodec())}


_lock = threading.Lock()
_inside = 0
_filters: warnings.catch_warnings[None] | None = None


@contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress zarr's warnings about features that its specification does not yet include (strings, pcodec, ...).

    Nested use by several threads is allowed: filters are process-wide, so the first thread sets and the last one
    restores them.
    """
    global _inside, _filters
    if getattr(sys.flags, "context_aware_warnings", False):
        # Recent versions of Python support filters per thread.
        with warnings.catch_warnings():
            _silence()
            yield
        return
    with _lock:
        if _inside == 0:
            _filters = warnings.catch_warnings()
            _filters.__enter__()
            _silence()
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _filters is not None:
                _filters.__exit__(None, None, None)
                _filters = None


def _silence() -> None:
    import zarr.errors

    for name in ("UnstableSpecificationWarning", "ZarrUserWarning"):
        warnings.filterwarnings("ignore", category=getattr(zarr.errors, name, FutureWarning))
    warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3")


ABSENT = 2**64 - 1
"""Position of a missing chunk in the chunk index."""
CHECKSUM_BYTES = 4
"""Size of the checksum after each chunk and after the chunk index."""


class ShardFile:
    """A shard file: all chunks of a variable, followed by the chunk index and the checksum of the index.

    zarr writes a shard only with all its chunks in memory; this class appends them singly. ``grid``: Chunks per axis.

    References
    ----------
    Zarr version 3, sharding codec, https://zarr-specs.readthedocs.io/en/latest/v3/codecs/sharding-indexed/
    """

    def __init__(self, path: Path, grid: Sequence[int]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: IO[bytes] = path.open("wb")
        self._index = np.full((*grid, 2), ABSENT, dtype="<u8")
        self._end = 0

    def put(self, at: Sequence[int], chunk: bytes) -> None:
        """Append a compressed chunk, including its checksum, for a position in the grid."""
        self._file.write(chunk)
        self._index[tuple(at)] = (self._end, len(chunk))
        self._end += len(chunk)

    @property
    def missing(self) -> int:
        """Number of chunks not yet written."""
        return int((self._index[..., 0] == ABSENT).sum())

    def close(self) -> None:
        """Write the chunk index, which completes the file."""
        self._file.write(with_checksum(self._index.tobytes()))
        self._file.close()

    def give_up(self) -> None:
        """Close the file without an index."""
        self._file.close()


def with_checksum(content: bytes) -> bytes:
    """Return bytes followed by their CRC-32C, in the format of zarr's ``crc32c`` codec."""
    import google_crc32c

    return content + int(google_crc32c.value(content)).to_bytes(CHECKSUM_BYTES, "little")


def without_checksum(content: bytes) -> bytes:
    """Return bytes without their CRC-32C after verifying it."""
    import google_crc32c

    plain, found = content[:-CHECKSUM_BYTES], content[-CHECKSUM_BYTES:]
    if int(google_crc32c.value(plain)).to_bytes(CHECKSUM_BYTES, "little") != found:
        msg = "a checksum is wrong"
        raise ValueError(msg)
    return plain

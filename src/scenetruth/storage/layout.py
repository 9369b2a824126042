"""How a variable lies in its store: chunks of one image or map each, all of them in one file, packed and checked."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

__all__ = ["chunk_shape", "codecs_of", "encoder_of", "is_mapped"]

_STEPPED = frozenset({"boundary_distance"})
"""Floats that take few values; what predicts smooth maps finds nothing in them."""

_LEVEL = 3
"""Of zstd: more takes twice as long for a few per cent."""


def is_mapped(dims: Sequence[Hashable]) -> bool:
    """Tell whether a variable has images or maps, which lie chunk by chunk in one file."""
    return "y" in dims and "x" in dims


def chunk_shape(dims: Sequence[Hashable], shape: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a chunk: one image or map; the channels of a colour stay together."""
    if not is_mapped(dims):
        return tuple(shape)
    return tuple(size if dim in ("y", "x", "channel") else 1 for dim, size in zip(dims, shape, strict=True))


def _is_smooth(name: str, dtype: np.dtype[Any]) -> bool:
    return dtype.kind == "f" and dtype.itemsize in (4, 8) and name not in _STEPPED


def encoder_of(name: str, dtype: np.dtype[Any]) -> Any:
    """Return what packs and unpacks one chunk of a variable, a codec of numcodecs.

    Floats go through pcodec, which stores how far each value is from what its neighbours predict, without loss: exact
    maps of smooth surfaces take a third of what byte shuffling and zstd leave. Everything else is shuffled and packed
    by zstd.
    """
    if _is_smooth(name, dtype):
        from numcodecs.pcodec import PCodec

        return PCodec()
    from numcodecs.blosc import Blosc

    return Blosc("zstd", clevel=_LEVEL, shuffle=Blosc.SHUFFLE, typesize=dtype.itemsize)


def codecs_of(name: str, dtype: np.dtype[Any]) -> dict[str, Any]:
    """Return the same as `encoder_of` in zarr's words, with the checksum that follows every chunk."""
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.codecs.numcodecs import PCodec

    if _is_smooth(name, dtype):
        return {"serializer": PCodec(), "compressors": (Crc32cCodec(),)}
    packed = BloscCodec(cname="zstd", clevel=_LEVEL, shuffle="shuffle", typesize=dtype.itemsize)
    return {"compressors": (packed, Crc32cCodec())}

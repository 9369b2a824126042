"""Files of chunks: zarr's sharding codec, written chunk by chunk as the images are made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

__all__ = ["ShardFile"]

_ABSENT = 2**64 - 1


class ShardFile:
    """One file that holds all chunks of a variable: the chunks, then where each lies, then a checksum of that.

    zarr itself can only write such a file at once, with all its chunks in memory.

    Parameters
    ----------
    path
        The file.
    grid
        Number of chunks along every dimension.

    References
    ----------
    Zarr version 3, sharding codec, https://zarr-specs.readthedocs.io/en/latest/v3/codecs/sharding-indexed/
    """

    def __init__(self, path: Path, grid: Sequence[int]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: IO[bytes] = path.open("wb")
        self._index = np.full((*grid, 2), _ABSENT, dtype="<u8")
        self._end = 0

    def put(self, at: Sequence[int], chunk: bytes) -> None:
        """Append a packed chunk, checksum included, which belongs at an index of the grid."""
        self._file.write(chunk)
        self._index[tuple(at)] = (self._end, len(chunk))
        self._end += len(chunk)

    @property
    def missing(self) -> int:
        """Number of chunks that have not been put yet."""
        return int((self._index[..., 0] == _ABSENT).sum())

    def close(self) -> None:
        """Write where the chunks lie; the file is whole then."""
        self._file.write(with_checksum(self._index.tobytes()))
        self._file.close()

    def give_up(self) -> None:
        """Close the file as it is."""
        self._file.close()


def with_checksum(content: bytes) -> bytes:
    """Return bytes followed by their CRC-32C, as zarr's codec ``crc32c`` writes it."""
    import google_crc32c

    return content + int(google_crc32c.value(content)).to_bytes(4, "little")

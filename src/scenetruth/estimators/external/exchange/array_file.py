"""Arrays of all images as .npy, written frame by frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["ArrayFile"]


class ArrayFile:
    """A file .npy of an array (s, t, ...), zero where nothing has been put; a context that closes it.

    A mapped file would do too, but its pages count as memory of the process until the system needs them elsewhere.

    Parameters
    ----------
    file
        The file.
    dtype
        The type of its numbers, written little endian.
    shape
        Its shape.
    """

    def __init__(self, file: Path, dtype: DTypeLike, shape: tuple[int, ...]) -> None:
        self._dtype, self._shape = np.dtype(dtype).newbyteorder("<"), shape
        self._opened = file.open("wb")
        head = {"descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._opened, head)
        self._first = self._opened.tell()
        self._image_bytes = self._dtype.itemsize * int(np.prod(shape[2:], dtype=np.int64))
        self._opened.truncate(self._first + shape[0] * shape[1] * self._image_bytes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()

    def put(self, place: int, values: NDArray[Any]) -> None:
        """Write what all cameras have of a frame: values of shape (s, ...), at a place along t."""
        for camera, image in enumerate(values):
            self._opened.seek(self._first + (camera * self._shape[1] + place) * self._image_bytes)
            self._opened.write(np.ascontiguousarray(image, dtype=self._dtype).tobytes())

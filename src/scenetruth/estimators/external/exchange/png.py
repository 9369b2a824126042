"""Images as PNG: grey ones of 16 bits, colours of 8 or 16 bits, masks."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["write_mask_png", "write_png"]

# Files live for the time of one program: writing must be quick.
_COMPRESSION = 1


def write_png(file: Path, image: NDArray[Any]) -> None:
    """Write an image of shape (y, x) or (y, x, 3), uint8 or uint16, as it is."""
    import imageio.v3 as imageio

    if image.ndim == 2 or image.dtype == np.uint8:
        imageio.imwrite(file, image, compress_level=_COMPRESSION)
        return
    # Pillow, which imageio writes with, has no colours of 16 bits.
    height, width, _ = image.shape
    # Every row begins with the number of its filter: none.
    rows = np.zeros((height, 1 + 6 * width), dtype=np.uint8)
    rows[:, 1:] = np.ascontiguousarray(image, dtype=">u2").view(np.uint8).reshape(height, 6 * width)
    # 16 bits, kind 2: red, green, blue.
    head = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), _COMPRESSION)
    parts = [_chunk(b"IHDR", head), _chunk(b"IDAT", body), _chunk(b"IEND", b"")]
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def write_mask_png(file: Path, bad: NDArray[np.bool_]) -> None:
    """Write a mask of shape (y, x): 255 where it is true, 0 elsewhere."""
    write_png(file, bad.astype(np.uint8) * np.uint8(255))

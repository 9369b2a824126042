"""Readers of formats, written from their published descriptions and not from what writes them."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def read_pfm(file: Path) -> Array:
    """PFM: 'Pf', width and height, scale whose sign is the byte order; rows from the bottom up."""
    content = file.read_bytes()
    head = re.match(rb"Pf\s+(\d+)\s+(\d+)\s+(-?[\d.]+)\n", content)
    assert head is not None
    width, height, scale = int(head[1]), int(head[2]), float(head[3])
    order = "<" if scale < 0 else ">"
    values = struct.unpack(f"{order}{width * height}f", content[head.end() :])
    return np.array([values[row * width : (row + 1) * width] for row in reversed(range(height))])


def read_flo(file: Path) -> Array:
    """Middlebury: bytes 0-3 'PIEH', 4-7 width, 8-11 height, then u, v row by row."""
    content = file.read_bytes()
    assert content[:4] == b"PIEH"
    width, height = struct.unpack("<ii", content[4:12])
    values = struct.unpack(f"<{2 * width * height}f", content[12:])
    return np.array(values).reshape(height, width, 2)


def read_dpt(file: Path) -> Array:
    """Sintel: as .flo, with one number for each pixel."""
    content = file.read_bytes()
    assert content[:4] == b"PIEH"
    width, height = struct.unpack("<ii", content[4:12])
    return np.array(struct.unpack(f"<{width * height}f", content[12:])).reshape(height, width)


def read_cam(file: Path) -> tuple[Array, Array]:
    """Sintel: the tag, then M (3 x 3) and N (3 x 4) in doubles."""
    content = file.read_bytes()
    assert content[:4] == b"PIEH"
    values = struct.unpack("<21d", content[4:])
    return np.array(values[:9]).reshape(3, 3), np.array(values[9:]).reshape(3, 4)


def read_settings(file: Path) -> dict[str, str]:
    """Middlebury's calib.txt: name=value."""
    return dict(line.split("=", 1) for line in file.read_text().splitlines())


def rotation_of(w: float, x: float, y: float, z: float) -> Array:
    """The matrix of a unit quaternion, as of Hamilton."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def opencv_image(file: Path) -> NDArray[Any]:
    """What OpenCV reads from an image file, with all its bits; colours are blue, green, red."""
    found = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return np.asarray(found)


def decode_runs(counts: list[int], size: list[int]) -> NDArray[np.bool_]:
    """COCO: lengths of runs of 0 and 1 in turn, column by column."""
    flat = [value for index, count in enumerate(counts) for value in [index % 2 == 1] * count]
    height, width = size
    return np.array([[flat[x * height + y] for x in range(width)] for y in range(height)])


def sampled(image: Array, x: Array, y: Array) -> Array:
    """An image at places between its pixels, by Catmull-Rom's cubic; NaN beyond the second pixel from its border."""
    height, width = image.shape
    inside = (x >= 1) & (x <= width - 3) & (y >= 1) & (y <= height - 3)
    x, y = np.where(inside, x, 1.0), np.where(inside, y, 1.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)

    def weights(f: Array) -> list[Array]:
        return [
            ((-f + 2) * f - 1) * f / 2,
            ((3 * f - 5) * f * f + 2) / 2,
            ((-3 * f + 4) * f + 1) * f / 2,
            (f - 1) * f * f / 2,
        ]

    found = np.zeros(x.shape)
    for row, down in enumerate(weights(y - top)):
        for column, across in enumerate(weights(x - left)):
            found += down * across * image[top + row - 1, left + column - 1]
    return np.where(inside, found, np.nan)

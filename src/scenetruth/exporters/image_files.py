"""Writers of single images and maps: PNG, PFM, Middlebury .flo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["FLO_TAG", "image_name", "write_flo", "write_mask", "write_pfm", "write_picture"]

FLO_TAG = 202021.25
"""First four bytes of .flo, .dpt and .cam files as a float, a check of the byte order."""

_FLO_UNKNOWN = 1e10


def image_name(s: int, t: int) -> str:
    """Return the name of an image without suffix: ``s+0_t+0``."""
    return f"s{s:+d}_t{t:+d}"


def write_picture(file: Path, image: NDArray[np.float64], bits: int = 8) -> None:
    """Write an image with full scale 1 as PNG, and create its directory."""
    import imageio.v3 as imageio

    file.parent.mkdir(parents=True, exist_ok=True)
    largest = 2**bits - 1
    values = np.rint(np.clip(np.nan_to_num(image), 0, 1) * largest)
    imageio.imwrite(file, values.astype(np.uint8 if bits == 8 else np.uint16))


def write_mask(file: Path, mask: NDArray[np.bool_]) -> None:
    """Write a mask as PNG: 255 where true, otherwise 0."""
    write_picture(file, mask.astype(np.float64))


def write_pfm(file: Path, values: NDArray[np.float64]) -> None:
    """Write a map of shape (y, x) as PFM: float32, little endian, rows from the bottom up, +inf for NaN."""
    file.parent.mkdir(parents=True, exist_ok=True)
    height, width = values.shape
    # A negative scale denotes little endian.
    head = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    file.write_bytes(head + np.where(np.isfinite(values), values, np.inf)[::-1].astype("<f4").tobytes())


def write_flo(file: Path, flow: NDArray[np.float64]) -> None:
    """Write a flow of shape (2, y, x) as .flo: float32, interleaved u and v, 1e10 for both where one is NaN."""
    file.parent.mkdir(parents=True, exist_ok=True)
    _, height, width = flow.shape
    known = np.isfinite(flow).all(axis=0)
    values = np.where(known, flow, _FLO_UNKNOWN)
    head = np.array(FLO_TAG, dtype="<f4").tobytes() + np.array([width, height], dtype="<i4").tobytes()
    file.write_bytes(head + np.moveaxis(values, 0, -1).astype("<f4").tobytes())

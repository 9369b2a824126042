"""Recordings with invalid pixels (NaN), as rectified recordings have them at the borders of their images."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

__all__ = ["touching", "with_invalid_pixels"]


def with_invalid_pixels(recording: xr.Dataset) -> xr.Dataset:
    """Return a recording whose images lack other columns and rows by camera, and single pixels by frame."""
    found = recording.copy(deep=True)
    images = found["image"].values
    images[0, ..., :7] = np.nan
    images[1:, ..., -3:, :] = np.nan
    images[-1, ..., -5:] = np.nan
    images[1, 0, 20, 30] = np.nan
    images[0, -1, 30, 44] = np.inf
    return found


def touching(invalid: NDArray[np.bool_], reach: int, right: int = 0, down: int = 0) -> NDArray[np.bool_]:
    """Return the pixels whose square window of an image read at an offset contains an invalid pixel, or its outside."""
    height, width = invalid.shape
    far = reach + abs(right) + abs(down)
    padded = np.pad(invalid, far, constant_values=True)
    out = np.zeros(invalid.shape, dtype=np.bool_)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            first, left = far + down + i, far + right + j
            out |= padded[first : first + height, left : left + width]
    return out

"""Resampling maps that were estimated between cameras or frames, at the pixels of the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

__all__ = ["carry_to_reference"]

_ROUNDS = 4


def carry_to_reference(
    moved: NDArray[np.float64], maps: NDArray[Any], flags: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Resample maps at the pixels of the reference, for rigs whose estimates belong between cameras or frames.

    Parameters
    ----------
    moved
        By how much the reference sees each pixel's point further right and down, in px, shape (2, y, x); NaN where
        there is no estimate.
    maps
        Floating-point maps, shape (n, y, x): interpolated linearly, NaN next to NaN.
    flags
        Maps of integers, shape (m, y, x): taken from the nearest pixel.

    Returns
    -------
    tuple of numpy.ndarray
        Both, resampled.
    """
    rows, columns = np.mgrid[: moved.shape[1], : moved.shape[2]].astype(np.float64)
    filled = np.nan_to_num(moved)
    # The pixel q whose point lands on r: q = r - moved(q), a contraction while surfaces do not fold.
    at = np.stack([rows, columns])
    for _ in range(_ROUNDS):
        shift = [map_coordinates(part, at, order=1, mode="nearest") for part in filled]
        at = np.stack([rows - shift[1], columns - shift[0]])
    known = np.isfinite(moved).all(axis=0)
    whole = map_coordinates(known.astype(np.float64), at, order=1, mode="constant") > 1 - 1e-9
    carried = np.stack(
        [np.where(whole, map_coordinates(part, at, order=1, mode="nearest"), np.nan) for part in maps]
    ).astype(maps.dtype)
    nearest = np.rint(at).astype(np.int64)
    nearest[0] = np.clip(nearest[0], 0, moved.shape[1] - 1)
    nearest[1] = np.clip(nearest[1], 0, moved.shape[2] - 1)
    return carried, np.where(whole, flags[:, *nearest], 0).astype(flags.dtype)

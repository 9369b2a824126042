"""The pieces of surface over which windows may reach."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

__all__ = ["inside_of", "pieces_of"]

# The spline of the derivative reaches further: a step 3 px away counts by a tenth of itself.
_REACH_PX = 2


def pieces_of(truth: xr.Dataset) -> NDArray[np.int64]:
    """Give numbers to the connected pieces of surface that the reference camera sees at the reference time.

    A piece ends at silhouettes and sharp edges, whose pixels belong to none, and where another object begins.

    Parameters
    ----------
    truth
        Maps of one camera and frame, dimensions (y, x): ``depth``, ``mixed``, and ``object_id`` if there is one.

    Returns
    -------
    numpy.ndarray
        Shape (y, x): 0, 1, ... for the pieces, and -1 where there is none.
    """
    from scipy.ndimage import label

    depth = truth["depth"].values
    seen = np.isfinite(depth) & (depth > 0) & ~truth["mixed"].values.astype(bool)
    objects = truth["object_id"].values if "object_id" in truth else np.zeros(depth.shape, dtype=np.int64)
    pieces = np.full(depth.shape, -1, dtype=np.int64)
    count = 0
    for number in np.unique(objects[seen]):
        labels, found = label(seen & (objects == number))
        pieces[labels > 0] = labels[labels > 0] + count - 1
        count += found
    return pieces


def inside_of(pieces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which pixels are at least 2 px away from all that is not of their own piece; beyond the image, nothing is.

    Elsewhere derivatives of the image are those of outlines, not of the surface's texture.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    size = 2 * _REACH_PX + 1
    same = maximum_filter(pieces, size, mode="nearest") == minimum_filter(pieces, size, mode="nearest")
    return np.asarray(same & (pieces >= 0))

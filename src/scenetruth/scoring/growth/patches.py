"""The connected pieces of surface in a depth map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

__all__ = ["surface_patches"]

Map = NDArray[np.float64]
Labels = NDArray[np.int32]


def surface_patches(
    depth: Map,
    focal_length_px: float,
    max_slope_deg: float = 80.0,
    *,
    objects: NDArray[np.generic] | None = None,
    step_px: tuple[float, float] = (1.0, 1.0),
) -> Labels:
    """Give numbers to the connected pieces of a depth map.

    Two pixels side by side belong to one surface if their depths differ by no more than
    tan(``max_slope_deg``) Z / f, with Z the nearer of both: by what a surface of that slope does over one pixel. Where
    it is known which object each pixel shows, they must also show the same one.

    Parameters
    ----------
    depth
        Depth in mm, shape (y, x); NaN where there is none.
    focal_length_px
        f, in pixels.
    max_slope_deg
        The steepest slope of one surface, in degrees.
    objects
        The number of the object that each pixel shows, shape (y, x); of one object if not given.
    step_px
        The distances between neighbouring pixels of the map, along y and along x, in px.

    Returns
    -------
    numpy.ndarray
        int32, shape (y, x): 0, 1, ... for the pieces, and -1 where there is no depth.
    """
    steepest = math.tan(math.radians(max_slope_deg)) / focal_length_px
    index = np.arange(depth.size).reshape(depth.shape)
    starts, ends = [], []
    sides = (((..., slice(-1)), (..., slice(1, None)), step_px[1]), (slice(-1), slice(1, None), step_px[0]))
    for one, other, step in sides:
        near, far = np.minimum(depth[one], depth[other]), np.maximum(depth[one], depth[other])
        # NaN compares as false, so that missing pixels touch nothing.
        joined = far - near <= steepest * step * near
        if objects is not None:
            joined &= objects[one] == objects[other]
        starts.append(index[one][joined])
        ends.append(index[other][joined])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_matrix((np.ones(start.size, dtype=np.int8), (start, end)), shape=(depth.size, depth.size))
    _, labels = connected_components(graph, directed=False)
    seen = np.isfinite(depth)
    numbers = np.full(depth.shape, -1, dtype=np.int32)
    numbers[seen] = np.unique(labels.reshape(depth.shape)[seen], return_inverse=True)[1].ravel()
    return numbers

"""The regions of the image over which errors are gathered."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.errors import Problem, ScoreError

__all__ = ["REGIONS", "edge_distance", "region_masks"]

Mask = NDArray[np.bool_]

REGIONS = ("all", "interior")
"""The names of the regions, in the order in which they are reported."""


def region_masks(depth: NDArray[np.floating], mixed: Mask, margin_px: float = 20.0) -> dict[str, Mask]:
    """Return where each region lies.

    ``all`` holds every pixel with a surface in the truth. ``interior`` holds those of them whose centre is at least
    ``margin_px`` away from the centre of every mixed pixel of the same frame, that is, away from silhouettes and from
    face edges of more than 1 degree. The border of the image is neither.

    Parameters
    ----------
    depth
        The true depth in mm, shape (..., y, x); NaN where there is no surface.
    mixed
        True where a pixel's footprint crosses a silhouette or such an edge, same shape.
    margin_px
        The least distance from mixed pixels, in px; not negative.

    Returns
    -------
    dict
        The region's name to a boolean array of the same shape.

    Raises
    ------
    ScoreError
        If the margin is negative or not finite.

    Examples
    --------
    >>> depth, mixed = np.ones((1, 5)), np.array([[True, False, False, False, False]])
    >>> region_masks(depth, mixed, margin_px=3)["interior"]
    array([[False, False, False,  True,  True]])
    """
    if not (math.isfinite(margin_px) and margin_px >= 0):
        raise ScoreError([Problem("margin_px", "must be a finite number, not negative", margin_px)])
    seen = np.isfinite(depth)
    return {"all": seen, "interior": seen & (edge_distance(mixed) >= margin_px)}


def edge_distance(mixed: Mask) -> NDArray[np.float64]:
    """Return the Euclidean distance from every pixel's centre to that of the nearest mixed pixel of its frame.

    Parameters
    ----------
    mixed
        True at mixed pixels, shape (..., y, x).

    Returns
    -------
    numpy.ndarray
        Distances in px, same shape; 0 at mixed pixels and infinite in a frame that has none.
    """
    edges = np.asarray(mixed, dtype=bool)
    distance = np.full(edges.shape, np.inf)
    for frame in np.ndindex(edges.shape[:-2]):
        # Without any mixed pixel the transform would measure from nowhere.
        if edges[frame].any():
            distance[frame] = ndimage.distance_transform_edt(~edges[frame])
    return distance

"""The outline of a mesh seen along Y: from its nearest to its farthest depth at every X."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["outline_of"]

Array = NDArray[np.float64]

_PLACES = 161
"""Places along X between which an outline is straight."""
_FEW = 200
"""The vertices of a mesh that has no more of them are such places too, so that its corners are kept."""


def outline_of(vertices_mm: Array, faces: NDArray[np.int32]) -> tuple[Array, Array, Array]:
    """Return the depths between which a mesh lies, over X.

    Parameters
    ----------
    vertices_mm
        Where its vertices are, shape (n, 3).
    faces
        Its triangles, shape (m, 3).

    Returns
    -------
    tuple of numpy.ndarray
        X, least and largest Z there, all in mm, X rising; where there is nothing at an X it is left out.
    """
    corners = vertices_mm[:, ::2]
    first, second = (faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel())
    start, end = corners[first], corners[second]
    turned = start[:, 0] > end[:, 0]
    start[turned], end[turned] = end[turned], start[turned].copy()
    places = np.linspace(corners[:, 0].min(), corners[:, 0].max(), _PLACES)
    if len(corners) <= _FEW:
        places = np.union1d(places, corners[:, 0])
    low = np.searchsorted(places, start[:, 0], side="left")
    high = np.searchsorted(places, end[:, 0], side="right")
    counts = high - low
    edge = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + low[edge]
    across = (end - start)[edge, 0]
    # Of an edge along Z both ends count.
    steep = across <= 0
    share = np.where(steep, 0.0, (places[place] - start[edge, 0]) / np.where(steep, 1.0, across))
    z_mm = start[edge, 1] + share * (end - start)[edge, 1]
    near, far = np.full(len(places), np.inf), np.full(len(places), -np.inf)
    for depths in (z_mm, np.where(steep, end[edge, 1], z_mm)):
        np.minimum.at(near, place, depths)
        np.maximum.at(far, place, depths)
    there = np.isfinite(near)
    return places[there], near[there], far[there]

"""Which sides of triangles lie on each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["places_of", "shared_sides"]

Indices = NDArray[np.int64]


def places_of(vertices: NDArray[np.float64]) -> Indices:
    """Return the number of every vertex's place, shape (n,); vertices at the same place count as one."""
    _, places = np.unique(vertices, axis=0, return_inverse=True)
    return np.asarray(places.reshape(-1), dtype=np.int64)


def shared_sides(corners: NDArray[np.integer]) -> tuple[Indices, Indices, NDArray[np.bool_]]:
    """Find the edges at which exactly two triangles meet.

    Parameters
    ----------
    corners
        Places of the corners of every triangle (`places_of`), shape (m, 3).

    Returns
    -------
    tuple of numpy.ndarray
        The two sides at every such edge, shape (k,) each: side 3 i + c runs from corner c of triangle i to the next;
        and whether both run the same way, so that one of the triangles is turned inside out.
    """
    half = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = half[:, 0] > half[:, 1]
    order = np.lexsort((half.min(axis=1), half.max(axis=1)))
    same = (np.sort(half, axis=1)[order][1:] == np.sort(half, axis=1)[order][:-1]).all(axis=1)
    # Edges of exactly two faces: a run of two.
    run = np.concatenate([[False], same, [False]])
    pairs = np.flatnonzero(run[1:-1] & ~run[:-2] & ~run[2:])
    one, two = order[pairs], order[pairs + 1]
    return one, two, turned[one] == turned[two]

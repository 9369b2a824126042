"""Faces of grids and discs, and into how many pieces lengths are cut."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

__all__ = ["CREASE_DEG", "disc_faces", "grid_faces", "pieces"]

CREASE_DEG = 60.0
"""Facets of a smooth surface meet at less, sides of a body at more."""


def pieces(length: float, longest: float) -> int:
    """Return into how many equal pieces a length is cut, none longer than stated."""
    # A length that is a multiple, but for rounding, is not cut once more.
    return max(ceil(length / longest - 1e-9), 1)


def grid_faces(columns: int, rows: int) -> NDArray[np.int32]:
    """Return two triangles for each cell of a grid of (rows + 1) x (columns + 1) vertices."""
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    down, right = first + columns + 1, first + 1
    both = down + 1
    faces = np.stack([np.column_stack([first, down, both]), np.column_stack([first, both, right])], axis=1)
    return faces.reshape(-1, 3).astype(np.int32)


def disc_faces(rings: int) -> NDArray[np.int32]:
    """Return the triangles of rings of 6, 12, 18, ... vertices around a middle; down x right points to the viewer."""
    faces = []
    for ring in range(1, rings + 1):
        outer_start = 3 * ring * (ring - 1) + 1
        inner_start = 0 if ring == 1 else outer_start - 6 * (ring - 1)
        inner_count, outer_count = max(6 * (ring - 1), 1), 6 * ring
        sector, step = np.divmod(np.arange(outer_count), ring)
        inner = sector * (ring - 1) + step
        outer = np.arange(outer_count)
        here, after = inner_start + inner % inner_count, inner_start + (inner + 1) % inner_count
        one, two = outer_start + outer, outer_start + (outer + 1) % outer_count
        faces.append(np.column_stack([here, two, one]))
        between = step < ring - 1
        faces.append(np.column_stack([here, after, two])[between])
    return np.concatenate(faces).astype(np.int32)

"""Cutting the image into tiles, one for a thread at a time."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.structure_tensor.registration import CELL

__all__ = ["Rectangle", "tiles_of"]


class Rectangle(NamedTuple):
    """A part of the image; ``bottom`` and ``right`` are the last row and column + 1."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def is_empty(self) -> bool:
        """Whether there is no pixel in it: the last row or column does not come after the first."""
        return self.bottom <= self.top or self.right <= self.left


# A tile's rows share their border's work; all threads' tiles together may need 256 MB of scratch.
_ROWS, _COLUMNS = 256, 512
_ROWS_OF_ALL_THREADS, _BORDER = 1900, 28
# Tiles of scattered cells are lower, to follow their outline; nearer runs than a window's border are joined.
_LOW_ROWS, _JOIN = 4 * CELL, 32


def tiles_of(area: Rectangle, cells: NDArray[np.bool_] | None, threads: int) -> NDArray[np.int64]:
    """Return tiles that cover the wanted cells inside an area, several for each thread.

    Parameters
    ----------
    area
        Where estimates can be made.
    cells
        Which cells of `CELL` px are wanted; None for all.
    threads
        Number of threads.

    Returns
    -------
    numpy.ndarray
        First row and the one behind the last, then columns, of every tile, shape (n, 4), int64.
    """
    top, bottom, left, right = area
    if area.is_empty:
        return np.empty((0, 4), dtype=np.int64)
    tiles: list[Rectangle] = []
    if cells is None:
        most = min(max(_ROWS_OF_ALL_THREADS // threads - _BORDER, 32), _ROWS)
        row_edges = _edges(top, bottom, max(threads, -(-(bottom - top) // most)))
        column_edges = _edges(left, right, -(-(right - left) // _COLUMNS))
        tiles = [Rectangle(*rows, *columns) for rows in pairwise(row_edges) for columns in pairwise(column_edges)]
    else:
        for first in range(top - top % _LOW_ROWS, bottom, _LOW_ROWS):
            rows = max(first, top), min(first + _LOW_ROWS, bottom)
            wanted = np.any(cells[first // CELL : -(-rows[1] // CELL)], axis=0, keepdims=True)[0]
            for start, stop in _runs(wanted):
                columns = max(start, left), min(stop, right)
                if columns[0] < columns[1]:
                    edges = _edges(*columns, -(-(columns[1] - columns[0]) // _COLUMNS))
                    tiles += [Rectangle(*rows, *part) for part in pairwise(edges)]
    return np.array(tiles, dtype=np.int64).reshape(-1, 4)


def _edges(first: int, last: int, count: int) -> list[int]:
    return [int(edge) for edge in np.linspace(first, last, min(count, last - first) + 1)]


def _runs(wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of wanted cells in px, near ones joined."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for start, stop in zip(steps[::2] * CELL, steps[1::2] * CELL, strict=True):
        if runs and start - runs[-1][1] < _JOIN:
            runs[-1] = (runs[-1][0], int(stop))
        else:
            runs.append((int(start), int(stop)))
    return runs

"""Slips of place: what a map shows of another pixel or of another frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOVES", "Grid", "Move", "Places"]

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Places:
    """Some pixels of some frames, by their places in the arrays, each of shape (n,).

    Parameters
    ----------
    frame
        Place along the frames of a `Grid`; negative where there is no such frame.
    y, x
        Row and column.
    """

    frame: Indices
    y: Indices
    x: Indices

    def shifted(self, down: int = 0, right: int = 0) -> Places:
        """Return the places so many pixels further down and to the right."""
        return replace(self, y=self.y + down, x=self.x + right)


@dataclass(frozen=True)
class Grid:
    """The frames and pixels of the maps.

    Parameters
    ----------
    rows, columns
        Size of the maps.
    following, preceding, opposite
        By frame: the place of the frame after it, before it, and of the one as far from the last as it is from the
        first; negative where there is none. Each has the shape (frame,).
    """

    rows: int
    columns: int
    following: Indices
    preceding: Indices
    opposite: Indices


@dataclass(frozen=True)
class Move:
    """A slip of place.

    Parameters
    ----------
    kind
        Its name.
    message
        What is told, with ``{quantity}``.
    source
        Gives the places whose values a map with the slip shows at some places; None where the slip cannot be.
    """

    kind: str
    message: str
    source: Callable[[Places, Grid], Places | None]


def _upside_down(places: Places, grid: Grid) -> Places:
    return replace(places, y=grid.rows - 1 - places.y)


def _mirrored(places: Places, grid: Grid) -> Places:
    return replace(places, x=grid.columns - 1 - places.x)


def _turned(places: Places, grid: Grid) -> Places:
    return _mirrored(_upside_down(places, grid), grid)


def _transposed(places: Places, grid: Grid) -> Places | None:
    return replace(places, y=places.x, x=places.y) if grid.rows == grid.columns else None


def _frames(places: Places, frames: Indices) -> Places | None:
    moved = frames[places.frame]
    return None if np.array_equal(moved, places.frame) else replace(places, frame=moved)


def _reversed(places: Places, grid: Grid) -> Places | None:
    return _frames(places, grid.opposite)


def _next(places: Places, grid: Grid) -> Places | None:
    return _frames(places, grid.following)


def _previous(places: Places, grid: Grid) -> Places | None:
    return _frames(places, grid.preceding)


MOVES = (
    Move(
        "rows_upside_down",
        "the maps of {quantity} are upside down: flip them, array[..., ::-1, :]; row 0 is at the top here",
        _upside_down,
    ),
    Move(
        "columns_mirrored",
        "the maps of {quantity} are mirrored: flip them, array[..., ::-1]; column 0 is at the left here",
        _mirrored,
    ),
    Move(
        "maps_turned",
        "the maps of {quantity} are turned by 180 degrees: flip both axes, array[..., ::-1, ::-1]",
        _turned,
    ),
    Move(
        "maps_transposed",
        "rows and columns of {quantity} are exchanged: transpose the maps, np.swapaxes(array, -2, -1)",
        _transposed,
    ),
    Move(
        "frames_reversed",
        "the frames of {quantity} are in reversed order: give the earliest first",
        _reversed,
    ),
    Move(
        "frame_after",
        "{quantity} is one frame off: the map of t + 1 is given for t; give the frames by t=",
        _next,
    ),
    Move(
        "frame_before",
        "{quantity} is one frame off: the map of t - 1 is given for t; give the frames by t=",
        _previous,
    ),
)
"""All slips of place by whole frames and maps, in the order in which they are preferred; a new one is an entry here."""

"""Where the errors of a frame are largest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.quantities import ENDPOINT
from scenetruth.scoring.report.viewer.layers import Layers

__all__ = ["Place", "worst_places"]

Map = NDArray[np.float64]

_BLOCK_PX = 32
"""The side of the squares among which the worst is looked for."""


@dataclass(frozen=True)
class Place:
    """Where the errors of a quantity are largest, in squares of 32 pixels of the map.

    Parameters
    ----------
    x, y
        The pixel of the square with the largest error, in px of the whole image.
    rms
        The rms error there, in the quantity's units.
    side_px
        The side of the square, in px of the whole image.
    """

    x: float
    y: float
    rms: float
    side_px: float


def worst_places(layers: Mapping[str, Layers], x: Map, y: Map) -> dict[str, Place]:
    """Return where the errors of each quantity are largest.

    Parameters
    ----------
    layers
        The maps of one frame, by their names.
    x, y
        The columns and rows of the maps, in px of the whole image.

    Returns
    -------
    dict
        By the keys of `QUANTITIES`, and ``flow`` for the length of the errors of the optical flow; those quantities
        that are known in a quarter of any square.
    """
    found = {name: _worst(errors, x, y) for name, errors in _errors(layers)}
    return {name: place for name, place in found.items() if place is not None}


def _errors(layers: Mapping[str, Layers]) -> Iterator[tuple[str, Map]]:
    """Give the maps of errors, and the lengths of those of vectors."""
    for name, one in layers.items():
        if "error" in one.maps:
            yield name, one.maps["error"]
    for name, parts in ((ENDPOINT, ("velocity_x", "velocity_y", "velocity_z")), ("flow", ("flow_x", "flow_y"))):
        maps = [layers[part].maps["error"] for part in parts if part in layers and "error" in layers[part].maps]
        if len(maps) == len(parts):
            yield name, np.sqrt(sum(values**2 for values in maps))


def _worst(errors: Map, x: Map, y: Map) -> Place | None:
    """Return the square with the largest rms error, of those that are known at a quarter of their pixels or more."""
    side = min(_BLOCK_PX, *errors.shape)
    rows, columns = errors.shape[0] // side, errors.shape[1] // side
    blocks = errors[: rows * side, : columns * side].reshape(rows, side, columns, side)
    finite = np.isfinite(blocks)
    counts = finite.sum(axis=(1, 3))
    squares = np.where(finite, blocks, 0.0) ** 2
    known = counts >= side**2 / 4
    if not known.any():
        return None
    rms = np.where(known, np.sqrt(squares.sum(axis=(1, 3)) / np.maximum(counts, 1)), -1.0)
    row, column = np.unravel_index(int(np.argmax(rms)), rms.shape)
    sizes = squares[row, :, column]
    down, across = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    width = float(abs(x[-1] - x[0])) / max(x.size - 1, 1)
    return Place(
        x=float(x[column * side + across]),
        y=float(y[row * side + down]),
        rms=float(rms[row, column]),
        side_px=side * width,
    )

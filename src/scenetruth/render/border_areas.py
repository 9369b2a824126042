"""Areas in pixels on both sides of borders, such as those of shadows, from the states of single points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["StateAt", "grid_offsets", "measure_areas"]

StateAt = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.uint64]]
"""Function that returns the states at points: pixel of each, ascending, shape (k,); offsets (x, y) in px, (k, 2)."""


def grid_offsets(cells: int) -> NDArray[np.float64]:
    """Return the nodes of a grid of cells x cells over a pixel, row by row, as offsets from its centre, (n, 2)."""
    lines = np.linspace(-0.5, 0.5, cells + 1)
    across, down = np.meshgrid(lines, lines)
    return np.column_stack([across.ravel(), down.ravel()])


def measure_areas(states: NDArray[np.uint64], state_at: StateAt, rounds: int) -> NDArray[np.float64]:
    """Return the area in px² that each node of a grid stands for, shape (pixels, cells + 1, cells + 1).

    The place where a border crosses a line between two nodes follows from bisection, and in the same manner the place
    where it crosses the perpendicular to the chord between two such places. Borders are straight between these places,
    so that the areas of straight borders are exact but for the bisection. Each half of a line without a border belongs
    to the node there.

    ``states``: At the nodes, see `grid_offsets`, shape (pixels, cells + 1, cells + 1).
    ``rounds``: Number of bisections; places are within 2^-(rounds + 1) of a line.
    """
    cells = states.shape[1] - 1
    across, down = _find_crossings(states, state_at, rounds)
    # Lines around a cell in the order of its nodes: above, to the right, below, and to the left.
    size = 1 / cells
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    shares = np.stack([across[:, :-1], down[:, :, 1:], 1 - across[:, 1:], 1 - down[:, :, :-1]], axis=-1)
    crossed = ~np.isnan(shares)
    split = np.where(crossed, shares, 0.5)[..., None]
    cuts = nodes + split * (np.roll(nodes, -1, axis=0) - nodes)
    number = crossed.sum(axis=-1)[..., None]
    # On the border, if it crosses two lines.
    middle = np.where(number > 0, (cuts * crossed[..., None]).sum(axis=-2) / np.maximum(number, 1), 0.5)
    _bend(states, state_at, rounds, crossed & (number == 2), cuts, middle)
    areas = np.zeros(states.shape)
    for k, (row, column) in enumerate(((0, 0), (0, 1), (1, 1), (1, 0))):
        # The node, the cut after it, the middle, and the cut before it.
        first, second = cuts[..., k, :] - nodes[k], cuts[..., k - 1, :] - nodes[k]
        diagonal = middle - nodes[k]
        doubled = _cross(first, diagonal) + _cross(diagonal, second)
        areas[:, row : cells + row, column : cells + column] += size**2 / 2 * doubled
    return areas


def _cross(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def _bend(
    states: NDArray[np.uint64], state_at: StateAt, rounds: int, crossed: NDArray[np.bool_], cuts: NDArray[np.float64],
    middle: NDArray[np.float64],
) -> None:  # fmt: skip
    """Move the middles of cells whose border crosses two lines to the border, in place."""
    cells = states.shape[1] - 1
    where = np.nonzero(crossed.any(axis=-1))
    ends = cuts[where][crossed[where]].reshape(-1, 2, 2)
    chord, start = ends[:, 1] - ends[:, 0], middle[where]
    across = np.stack([-chord[:, 1], chord[:, 0]], axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    nodes = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    ahead = (nodes - start[:, None]) @ across[..., None]
    one, other = (nodes[find(ahead[..., 0], axis=1)] for find in (np.argmax, np.argmin))
    state_ahead, state_behind = (
        states[where[0], where[1] + node[:, 1], where[2] + node[:, 0]] for node in (one, other)
    )
    # To the sides of the cell in both directions.
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = [np.nanmin(np.where(sign * across > 0, 1 - start, start) / np.abs(across), axis=1) for sign in (1, -1)]
    corner = np.stack(where[:0:-1], axis=-1)

    def found(at: NDArray[np.float64], some: NDArray[np.int64]) -> NDArray[np.uint64]:
        places = (corner[some] + start[some] + at[:, None] * across[some]) / cells - 0.5
        return state_at(where[0][some], places)

    every = np.arange(len(start))
    high, low = reach[0], -reach[1]
    some = np.flatnonzero(
        (found(high, every) == state_ahead) & (found(low, every) == state_behind) & (state_ahead != state_behind)
    )
    high, low = high[some], low[some]
    for _ in range(rounds):
        half = (low + high) / 2
        same = found(half, some) == state_behind[some]
        low, high = np.where(same, half, low), np.where(same, high, half)
    middle[tuple(index[some] for index in where)] += ((low + high) / 2)[:, None] * across[some]


def _find_crossings(
    states: NDArray[np.uint64], state_at: StateAt, rounds: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where borders cross the lines across and down between nodes, as fractions, NaN without a border."""
    cells = states.shape[1] - 1
    across = np.full((len(states), cells + 1, cells), np.nan)
    down = np.full((len(states), cells, cells + 1), np.nan)
    sides = (across, states[:, :, :-1], states[:, :, 1:]), (down, states[:, :-1], states[:, 1:])
    where = [np.nonzero(one != other) for _, one, other in sides]
    pixels = np.concatenate([index[0] for index in where])
    if not len(pixels):
        return across, down
    order = np.argsort(pixels, kind="stable")
    pixels = pixels[order]
    first = np.concatenate([one[index] for index, (_, one, _) in zip(where, sides, strict=True)])[order]
    starts = np.concatenate([np.column_stack(index[:0:-1]) for index in where])[order] / cells - 0.5
    way = np.repeat([[1.0, 0.0], [0.0, 1.0]], [len(index[0]) for index in where], axis=0)[order] / cells
    low, high = np.zeros(len(pixels)), np.ones(len(pixels))
    for _ in range(rounds):
        middle = (low + high) / 2
        same = state_at(pixels, starts + middle[:, None] * way) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    found = np.empty(len(pixels))
    found[order] = (low + high) / 2
    across[where[0]], down[where[1]] = np.split(found, [len(where[0][0])])
    return across, down

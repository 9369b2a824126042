"""Images of textured boards that face the cameras, from formulas alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Board:
    """A board that the reference sees between columns and rows; the last one of a list fills the image."""

    disparity: float
    columns: tuple[float, float] = (-1e9, 1e9)
    rows: tuple[float, float] = (-1e9, 1e9)
    flow: tuple[float, float] = (0.0, 0.0)
    approach: float = 0.0
    """Share of its distance that it comes nearer per frame."""


def _texture(x: Array, y: Array, seed: int) -> Array:
    generator = np.random.default_rng(seed)
    waves = 40
    lengths = np.exp(generator.uniform(np.log(4.0), np.log(16.0), waves))
    angles, phases = generator.uniform(0, 2 * np.pi, (2, waves))
    total = np.zeros_like(x)
    for length, angle, phase in zip(lengths, angles, phases, strict=True):
        total += np.cos(2 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / length + phase)
    return total


def draw(
    boards: Sequence[Board], size: tuple[int, int], position: float, t: float = 0.0, noise: float = 0.01
) -> NDArray[np.float32]:
    """Return the image of a camera, nearest boards first, with grey values of standard deviation 0.2.

    A board's point at (X, Y) from the middle of the reference's image at time 0 is seen at time t at
    ((X + u t - d s) g, (Y + v t) g) with g = 1 / (1 - approach t): d q_Z / f = -approach.
    """
    height, width = size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - (width - 1) / 2, y - (height - 1) / 2
    image = np.zeros(size)
    open_ = np.ones(size, dtype=bool)
    for number, board in enumerate(boards):
        g = 1 / (1 - board.approach * t)
        there_x = x / g + board.disparity * position - board.flow[0] * t
        there_y = y / g - board.flow[1] * t
        column, row = there_x + (width - 1) / 2, there_y + (height - 1) / 2
        inside = (column >= board.columns[0]) & (column < board.columns[1])
        inside &= (row >= board.rows[0]) & (row < board.rows[1]) & open_
        image[inside] = _texture(there_x[inside], there_y[inside], number)
        open_ &= ~inside
    generator = np.random.default_rng(int(1000 * (position + 50) + 7 * t + 1))
    return np.asarray(0.2 * (image / np.sqrt(20.0) + generator.normal(0, noise, size)), dtype=np.float32)


def images_of(
    boards: Sequence[Board], size: tuple[int, int], positions: Sequence[float], t: float = 0.0, noise: float = 0.01
) -> NDArray[np.float32]:
    """Return the images of all cameras, shape (1, s, y, x)."""
    return np.stack([draw(boards, size, s, t, noise) for s in positions])[None]


def true_board(boards: Sequence[Board], size: tuple[int, int]) -> NDArray[np.int64]:
    """Return which board the reference sees at time 0."""
    y, x = np.mgrid[: size[0], : size[1]]
    seen = np.full(size, len(boards) - 1)
    for number in reversed(range(len(boards))):
        board = boards[number]
        inside = (x >= board.columns[0]) & (x < board.columns[1]) & (y >= board.rows[0]) & (y < board.rows[1])
        seen[inside] = number
    return seen


def true_disparity(boards: Sequence[Board], size: tuple[int, int]) -> Array:
    """Return the disparity of the reference's pixels at time 0."""
    return np.array([board.disparity for board in boards])[true_board(boards, size)]


def away_from_outlines(values: NDArray[np.generic], margin: int) -> NDArray[np.bool_]:
    """Mark pixels whose square of some px to every side has one value only."""
    from scipy import ndimage

    side = 2 * margin + 1
    return np.asarray(ndimage.maximum_filter(values, side) == ndimage.minimum_filter(values, side))

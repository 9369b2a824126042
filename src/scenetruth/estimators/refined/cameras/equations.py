"""Normal equations of all images' corrections, with depth and motion of every block of pixels eliminated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.cameras.points import CORRECTIONS, moves_of
from scenetruth.estimators.refined.cameras.shifts import Shifts
from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["Blocks", "Elimination", "Equations", "blocks_of"]

# Blocks that fewer pixels show in the mean of the images say nothing.
_LEAST_SHARE = 0.5
# Directions that blocks do not tell: eigenvalues below this share of what one parameter alone is told by.
_UNTOLD = 1e-7
# Frames from which on acceleration is told from velocity.
_ACCELERATED = 5
# Blocks that are taken at a time, and about how many of all are taken.
_PIECE, _MOST_BLOCKS = 256, 6000

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Blocks:
    """What blocks of pixels tell."""

    weight: Array
    """Σ ∇T ∇Tᵀ of every image, shape (blocks, n, 2, 2)."""
    shift: Array
    """Σ ∇T (T - g), shape (blocks, n, 2)."""
    fields: Array
    """d, q_X, q_Y and q_Z, shape (4, blocks)."""
    at: Array
    """Column and row of their middles, shape (2, blocks)."""
    noise: float
    """Standard deviation of what the images leave around their mean in blocks that fit well."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the corrections c of n images, image by image: matrix · c = side."""

    matrix: Array
    """Shape (4 n, 4 n)."""
    side: Array
    """Shape (4 n,)."""


def blocks_of(shifts: Shifts, fields: Array) -> Blocks:
    """Return what blocks tell that show texture.

    Parameters
    ----------
    shifts
        The sums over blocks.
    fields
        d, q_X, q_Y and q_Z of every pixel, finite, shape (4, y, x).
    """
    rows, columns = shifts.centres()
    height, width = fields.shape[1:]
    rows, columns = np.minimum(rows, height - 1), np.minimum(columns, width - 1)
    counts = shifts.sums[..., 6].mean(axis=-1)
    told = counts > _LEAST_SHARE * counts.max()
    apart = math.isqrt(told.size // _MOST_BLOCKS) + 1
    some = np.zeros_like(told)
    some[::apart, ::apart] = True
    told &= some
    sums = shifts.sums[told]
    left = np.sqrt(sums[..., 5].sum(axis=-1) / np.maximum(sums[..., 6].sum(axis=-1), 1.0))
    images = max(sums.shape[1] - 1, 1)
    noise = float(np.quantile(left, 0.25)) * np.sqrt(sums.shape[1] / images) if left.size else float("nan")
    return Blocks(
        sums[..., [0, 1, 1, 2]].reshape(*sums.shape[:2], 2, 2),
        sums[..., 3:5],
        fields[:, rows[told], columns[told]],
        np.stack([columns[told], rows[told]]).astype(np.float64),
        noise,
    )


class Elimination:
    """The equations of the corrections alone: those of every block's own depth and motion are solved for any of them.

    Parameters
    ----------
    blocks
        What blocks tell.
    view
        Where and when the images were taken.
    """

    def __init__(self, blocks: Blocks, view: View) -> None:
        self._noise = blocks.noise
        self._size = CORRECTIONS * len(view.s)
        accelerated = len(np.unique(view.t)) >= _ACCELERATED
        self._parts = [
            _part_of(blocks, view, slice(first, first + _PIECE), accelerated=accelerated)
            for first in range(0, len(blocks.shift), _PIECE)
        ]

    def equations(self, weight: Array) -> Equations:
        """Return the equations of all blocks together.

        Parameters
        ----------
        weight
            Weights of the blocks, shape (blocks,).
        """
        matrix, side = np.zeros((self._size, self._size)), np.zeros(self._size)
        own = np.zeros((self._size // CORRECTIONS, CORRECTIONS, CORRECTIONS))
        for part, w in self._weighted(weight):
            own += np.tensordot(w, part.own, 1)
            side += w @ part.side
            rooted = (np.sqrt(w)[:, None, None] * part.mixed).reshape(-1, self._size)
            matrix -= rooted.T @ rooted
        for n in range(len(own)):
            at = slice(CORRECTIONS * n, CORRECTIONS * (n + 1))
            matrix[at, at] += own[n]
        return Equations(matrix, side)

    def misfit(self, corrections: Array) -> Array:
        """Return what corrections leave of the blocks' shifts when their depth and motion follow.

        Parameters
        ----------
        corrections
            Of every image, shape (n, 4).

        Returns
        -------
        numpy.ndarray
            In squares of the images' noise per free shift, shape (blocks,).
        """
        c = corrections.ravel()
        found = []
        for part in self._parts:
            # |shift - c|² in the norm of all unknowns, less what the blocks' own parameters take of it.
            moved = np.einsum("pnij,nj->pni", part.own, corrections, optimize=True).reshape(len(part.free), -1)
            square = part.square - 2.0 * part.plain @ c + moved @ c
            own = part.own_shift - part.mixed @ c
            found.append((square - (own**2).sum(axis=-1)) / (part.free * self._noise**2))
        return np.concatenate(found)

    def _weighted(self, weight: Array) -> Iterator[tuple[_Part, Array]]:
        for number, part in enumerate(self._parts):
            yield part, weight[number * _PIECE : (number + 1) * _PIECE]


@dataclass(frozen=True, eq=False)
class _Part:
    """Products of some blocks, p of them."""

    own: Array
    """Σ Eᵀ W E of every image with its corrections' derivatives E, shape (p, n, 4, 4)."""
    mixed: Array
    """Those of the blocks' own parameters, told apart, with all corrections, shape (p, m, 4 n)."""
    plain: Array
    """Σ Eᵀ W δ, shape (p, 4 n)."""
    own_shift: Array
    """The same of the own parameters, shape (p, m)."""
    square: Array
    """Σ δᵀ W δ, shape (p,)."""
    free: Array
    """How many shifts there are, less the own parameters, at least 1, shape (p,)."""

    @property
    def side(self) -> Array:
        """Right side of the corrections' equations, shape (p, 4 n)."""
        return np.asarray(self.plain - np.einsum("pms,pm->ps", self.mixed, self.own_shift, optimize=True))


def _part_of(blocks: Blocks, view: View, part: slice, *, accelerated: bool) -> _Part:
    moves = moves_of(view, blocks.fields[:, part], blocks.at[:, part], accelerated=accelerated)
    weight, shift = blocks.weight[part], blocks.shift[part]
    a, e = moves.by_point, moves.by_image
    count = len(weight)
    weighted = np.matmul(weight, a)
    matrix = np.matmul(a.reshape(count, -1, a.shape[-1]).swapaxes(1, 2), weighted.reshape(count, -1, a.shape[-1]))
    size = np.sqrt(np.maximum(np.einsum("pii->pi", matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / (size[:, :, None] * size[:, None]))
    told = values > _UNTOLD
    apart = vectors * np.where(told, 1.0 / np.sqrt(np.maximum(values, _UNTOLD)), 0.0)[:, None] / size[:, :, None]
    by_image = np.matmul(weight, e)
    mixed = np.einsum("pnki,pnkj->pinj", a, by_image, optimize=True).reshape(count, a.shape[-1], -1)
    square, shifts = _squares(weight, shift)
    return _Part(
        np.matmul(e.swapaxes(-1, -2), by_image),
        np.matmul(apart.swapaxes(1, 2), mixed),
        np.einsum("pnki,pnk->pni", e, shift, optimize=True).reshape(count, -1),
        np.einsum("pim,pnki,pnk->pm", apart, a, shift, optimize=True),
        square,
        np.maximum(shifts - told.sum(axis=1), 1).astype(np.float64),
    )


def _squares(weight: Array, shift: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return Σ bᵀ W⁻¹ b of every block, and how many shifts its images tell: two each, or one along a gradient."""
    a, b, c = weight[..., 0, 0], weight[..., 0, 1], weight[..., 1, 1]
    half, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    largest = half + spread
    determinant = a * c - b * b
    both = determinant > 1e-3 * largest**2
    x, y = shift[..., 0], shift[..., 1]
    whole = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(both, determinant, 1.0)
    # Along the gradient alone, b lies in its direction, but for rounding.
    some = largest > 0
    along = (x * x + y * y) / np.where(some, largest, 1.0)
    square = np.where(both, whole, np.where(some, along, 0.0)).sum(axis=1)
    return square, (2 * both + (some & ~both)).sum(axis=1)

"""Normal equations of all images' corrections, with depth and motion of every block of pixels eliminated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.cameras.points import CORRECTIONS, moves_of
from scenetruth.estimators.refined.cameras.shifts import Shifts
from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["Blocks", "Equations", "blocks_of", "eliminated", "misfit"]

# Blocks that fewer pixels show in the mean of the images say nothing.
_LEAST_SHARE = 0.5
# Directions that blocks do not tell: eigenvalues below this share of what one parameter alone is told by.
_UNTOLD = 1e-7
# Frames from which on acceleration is told from velocity.
_ACCELERATED = 5
# Blocks that are taken at a time.
_PIECE = 256

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


def _pieces(blocks: Blocks, view: View) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Give derivatives by points and by images, and what takes parameters of points to such that are told apart."""
    accelerated = len(np.unique(view.t)) >= _ACCELERATED
    for first in range(0, len(blocks.shift), _PIECE):
        part = slice(first, first + _PIECE)
        moves = moves_of(view, blocks.fields[:, part], blocks.at[:, part], accelerated=accelerated)
        matrix = np.einsum("pnki,pnkl,pnlj->pij", moves.by_point, blocks.weight[part], moves.by_point, optimize=True)
        size = np.sqrt(np.maximum(np.einsum("pii->pi", matrix), 1e-300))
        values, vectors = np.linalg.eigh(matrix / (size[:, :, None] * size[:, None]))
        share = np.where(values > _UNTOLD, 1.0 / np.sqrt(np.maximum(values, _UNTOLD)), 0.0)
        yield part, moves.by_point, moves.by_image, vectors * share[:, None] / size[:, :, None]


def eliminated(blocks: Blocks, view: View, weight: Array) -> Equations:
    """Return the equations of the corrections alone: those of the points are solved for any of them.

    Parameters
    ----------
    blocks
        What blocks tell.
    view
        Where and when the images were taken.
    weight
        Weights of the blocks, shape (blocks,).
    """
    count = len(view.s)
    size = CORRECTIONS * count
    matrix, side = np.zeros((size, size)), np.zeros(size)
    own = np.zeros((count, CORRECTIONS, CORRECTIONS))
    for part, by_point, by_image, apart in _pieces(blocks, view):
        w = weight[part]
        told = np.einsum("pnkl,pnlj->pnkj", blocks.weight[part], by_image)
        own += np.einsum("p,pnki,pnkj->nij", w, by_image, told, optimize=True)
        mixed = np.einsum("pnki,pnkj->pinj", by_point, told).reshape(len(w), -1, size)
        mixed = np.einsum("pim,pis->pms", apart, mixed, optimize=True)
        shifts = np.einsum("pim,pnki,pnk->pm", apart, by_point, blocks.shift[part], optimize=True)
        side += np.einsum("p,pnki,pnk->ni", w, by_image, blocks.shift[part], optimize=True).ravel()
        side -= np.einsum("p,pms,pm->s", w, mixed, shifts, optimize=True)
        rooted = (np.sqrt(w)[:, None, None] * mixed).reshape(-1, size)
        matrix -= rooted.T @ rooted
    for n in range(count):
        at = slice(CORRECTIONS * n, CORRECTIONS * (n + 1))
        matrix[at, at] += own[n]
    return Equations(matrix, side)


def misfit(blocks: Blocks, view: View, corrections: Array) -> Array:
    """Return what corrections leave of the blocks' shifts when their depth and motion follow: Σ ∇T-weighted squares.

    Parameters
    ----------
    blocks, view
        As of `eliminated`.
    corrections
        Of every image, shape (n, 4).

    Returns
    -------
    numpy.ndarray
        In squares of the images' noise per free shift, shape (blocks,).
    """
    found = np.empty(len(blocks.shift))
    for part, by_point, by_image, apart in _pieces(blocks, view):
        weight = blocks.weight[part]
        left = blocks.shift[part] - np.einsum("pnkl,pnlj,nj->pnk", weight, by_image, corrections, optimize=True)
        shifts = np.einsum("pim,pnki,pnk->pm", apart, by_point, left, optimize=True)
        values, vectors = np.linalg.eigh(weight)
        along = np.einsum("pnkm,pnk->pnm", vectors, left)
        least = 1e-3 * values[..., 1:]
        square = np.where(values > least, along**2 / np.maximum(values, least + 1e-300), 0.0).sum(axis=(1, 2))
        free = (values > least).sum(axis=(1, 2)) - (apart**2 > 0).any(axis=1).sum(axis=-1)
        found[part] = (square - (shifts**2).sum(axis=-1)) / (np.maximum(free, 1) * blocks.noise**2)
    return found

"""Whether maps are shifted by a whole or by half a pixel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.slips.hypothesis import Hypothesis
from scenetruth.scoring.slips.material import Material
from scenetruth.scoring.slips.moves import Places
from scenetruth.scoring.slips.slip import Slip
from scenetruth.scoring.slips.weighing import lengths

__all__ = ["ShiftFit", "fitted_shift"]

Map = NDArray[np.float64]
Indices = NDArray[np.intp]

_PIXELS = 4000
_SHARE = 1 / 16
"""So many pixels, or this share of a map if that is more, are looked at: in larger images slopes per pixel are less."""

_LEAST_PIXELS = 200
_LEAST_BLOCKS = 12
"""With fewer, the standard error is not known."""

_BLOCKS = 8
"""Blocks along each side of the map, for the standard error; errors of methods reach over windows, not over blocks."""

_LARGEST_STD_PX = 0.06
"""Largest standard error: half a pixel is eight of it from zero."""

_REACH_PX = 0.15
"""How far a measured shift may be from a half or a whole pixel: 2.5 of the largest standard errors."""

_LEAST_EXPLAINED = 0.05
"""Least share of the squared misfit away from edges. A shift changes little there beside a method's noise, so that its
standard error decides; this leaves out what explains nothing to speak of."""

_LEAST_OWN = 0.01
"""Least share of a gradient's variance that an offset, a gain, blur and the other gradient do not account for."""

_FLOOR_PX = 0.02
"""Errors smaller than those of such a shift are taken as equally good."""

_ROUNDS = 4
_TUKEY = 4.685
_OF_MEDIAN = 1 / 0.6745
"""Standard deviation of normal errors over the median of their absolute values; Tukey's limit of outliers in it."""


@dataclass(frozen=True)
class ShiftFit:
    """What a shift explains.

    Parameters
    ----------
    right, down
        By how many pixels the maps are shifted: 0, 1/2 or 1 in both directions, or None where that is not known.
    explained
        Share of the squared misfit away from edges that undoing the shift takes away.
    left
        Median of the misfit that is left.
    """

    right: float | None
    down: float | None
    explained: float
    left: float

    @property
    def is_slip(self) -> bool:
        """Whether the maps are shifted."""
        return bool(self.right or self.down) and self.explained >= _LEAST_EXPLAINED

    def slips(self, quantity: str) -> list[Slip]:
        """Return what is told of a quantity."""
        if not self.is_slip:
            return []
        ways = [
            f"{abs(length):g} px {words[length > 0]}"
            for length, words in ((self.right, ("left", "right")), (self.down, ("up", "down")))
            if length
        ]
        where = f"the maps of {quantity} are shifted by {' and '.join(ways)}"
        if 0.5 in (abs(self.right or 0), abs(self.down or 0)):
            message = f"{where}, as if sampled at the corners of pixels: pixel centres are at integer x and y here"
            return [Slip("half_pixel", quantity, message, self.explained)]
        message = f"{where}, as if pixels were counted from 1: the first pixel is x = 0, y = 0 here; shift them back"
        return [Slip("one_pixel", quantity, message, self.explained)]


def fitted_shift(material: Material, hypothesis: Hypothesis) -> ShiftFit | None:
    """Return the shift that explains most of what slips leave, or None where it cannot be measured.

    Errors are fitted by the gradients of the truth with its slips, by robust least squares together with an offset, a
    gain and blur (the Laplacian) of every component, which thus are never taken for a shift. On a plane of constant
    slope an offset looks like a shift, so that none is measured there. The standard error is that of the jackknife
    over blocks of the map.

    Parameters
    ----------
    material
        The quantity.
    hypothesis
        The slips.
    """
    grid = material.grid
    places = material.drawn(max(_PIXELS, int(_SHARE * grid.rows * grid.columns)), inner=True)
    if len(places.y) < _LEAST_PIXELS:
        return None
    middle, left, right, above, below = (
        hypothesis.predicted(material, places.shifted(down, right))
        for down, right in ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
    )
    gradients = np.stack([0.5 * (left - right), 0.5 * (above - below)])
    blur = left + right + above + below - 4 * middle
    known = np.isfinite(blur).all(axis=0) & np.isfinite(middle).all(axis=0)
    if known.sum() < _LEAST_PIXELS:
        return None
    error = (material.estimate_at(places) - middle)[:, known]
    rows = _Rows.of(error, middle[:, known], gradients[..., known], blur[:, known])
    blocks = _block_of(places, material)[known]
    return None if rows is None else _measured(rows, blocks)


@dataclass(frozen=True)
class _Rows:
    """The linear model of a quantity's errors.

    Parameters
    ----------
    error
        Errors in units of their spread, shape (n * component,): those of a pixel follow each other.
    columns
        What they may follow from, shape (n * component, k): the two gradients, then what is no shift.
    size
        The units, shape (component,).
    """

    error: Map
    columns: Map
    size: Map

    @classmethod
    def of(cls, error: Map, middle: Map, gradients: Map, blur: Map) -> _Rows | None:
        """Return the model, or None where nothing has a gradient; all arrays have the shape (..., component, n)."""
        steepest = np.median(np.abs(gradients), axis=2).max()
        spread = _OF_MEDIAN * np.median(np.abs(error - np.median(error, axis=1, keepdims=True)), axis=1)
        size = np.maximum(spread, _FLOOR_PX * steepest)
        if not (steepest > 0 and (size > 0).all()):
            return None
        count, n = error.shape
        columns = np.zeros((n, count, 2 + 3 * count))
        columns[..., :2] = gradients.T
        for place in range(count):
            columns[:, place, 2 + 3 * place] = 1.0
            columns[:, place, 3 + 3 * place] = middle[place] - middle[place].mean()
            columns[:, place, 4 + 3 * place] = blur[place]
        columns /= size[:, np.newaxis]
        # Columns of one size: products of small and large ones would be lost in rounding.
        lengths_of = np.sqrt(np.square(columns[..., 2:]).sum(axis=(0, 1)))
        columns[..., 2:] /= np.where(lengths_of > 0, lengths_of, 1.0)
        return cls((error.T / size).ravel(), columns.reshape(n * count, -1), size)

    def without(self, dropped: Sequence[int]) -> _Rows:
        """Return the model without some columns."""
        return replace(self, columns=np.delete(self.columns, dropped, axis=1)) if dropped else self

    def normal(self, weights: Map) -> tuple[Map, Map]:
        """Return matrix and right side of the normal equations, with a weight for every pixel."""
        weighted = self.columns * np.repeat(weights, len(self.size))[:, np.newaxis]
        return self.columns.T @ weighted, weighted.T @ self.error

    def left(self, solution: Map) -> Map:
        """Return what a solution leaves, shape (component, n)."""
        return np.asarray((self.error - self.columns @ solution).reshape(-1, len(self.size)).T)

    def misfit(self, solution: Map) -> float:
        """Return the median of what a solution leaves, in the units of the quantity."""
        return float(np.median(lengths(self.left(solution) * self.size[:, np.newaxis])))


def _measured(rows: _Rows, blocks: Indices) -> ShiftFit | None:
    weights = _first_weights(rows)
    # A gradient that follows from offset, gain and blur tells nothing.
    own = _own_shares(rows, weights)
    axes = [axis for axis in (0, 1) if own[axis] >= _LEAST_OWN]
    if not axes:
        return None
    fitted = rows.without([axis for axis in (0, 1) if axis not in axes])
    solution, last = _fit(fitted, weights)
    left = fitted.misfit(solution)
    shift: list[float | None] = [None, None]
    if np.abs(solution[: len(axes)]).max() < 0.5 - _REACH_PX:
        return ShiftFit(None, None, 0.0, left)
    std = _jackknife(fitted, last, blocks)
    for axis, length, error in zip(axes, solution, std, strict=False):
        if error <= _LARGEST_STD_PX:
            nearest = 0.5 * round(2 * length)
            if abs(nearest) > 1 or abs(length - nearest) > _REACH_PX:
                return ShiftFit(None, None, 0.0, left)
            shift[axis] = nearest
    unshifted = rows.without([0, 1])
    there = unshifted.misfit(_fit(unshifted, weights)[0])
    return ShiftFit(shift[0], shift[1], 1 - (left / there) ** 2 if there > 0 else 0.0, left)


def _first_weights(rows: _Rows) -> Map:
    error = rows.error.reshape(-1, len(rows.size))
    size = np.abs(error - np.median(error, axis=0)).max(axis=1)
    return np.asarray((size <= _TUKEY * max(1.0, _OF_MEDIAN * float(np.median(size)))).astype(np.float64))


def _fit(rows: _Rows, weights: Map) -> tuple[Map, Map]:
    """Return the solution of robust least squares (Tukey's weights), and its weights."""
    solution = _solved(*rows.normal(weights))
    for _ in range(_ROUNDS):
        size = lengths(rows.left(solution))
        limit = _TUKEY * max(_OF_MEDIAN * float(np.median(size)), 1e-6)
        weights = np.square(np.maximum(1 - np.square(size / limit), 0.0))
        solution = _solved(*rows.normal(weights))
    return solution, weights


def _solved(matrix: Map, side: Map) -> Map:
    """Return the solutions of normal equations whose columns may depend on each other; shapes (..., k, k), (..., k)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), np.finfo(float).tiny))
    ridge = 1e-10 * np.eye(side.shape[-1])
    even = matrix / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + ridge
    return np.asarray(np.linalg.solve(even, (side / scale)[..., np.newaxis])[..., 0] / scale)


def _own_shares(rows: _Rows, weights: Map) -> list[float]:
    """Return by axis the share of the gradient's square that no other column accounts for."""
    matrix, _ = rows.normal(weights)
    scale = np.sqrt(np.diag(matrix))
    shares = []
    for axis in (0, 1):
        others = [place for place in range(len(matrix)) if place != axis and scale[place] > 0]
        if not scale[axis] > 0:
            shares.append(0.0)
            continue
        inner = matrix[np.ix_(others, others)] / np.outer(scale[others], scale[others])
        cross = matrix[others, axis] / (scale[others] * scale[axis])
        shares.append(1 - float(cross @ np.linalg.lstsq(inner, cross, rcond=1e-10)[0]))
    return shares


def _jackknife(rows: _Rows, weights: Map, blocks: Indices) -> Map:
    """Return the standard errors of a solution, from leaving out one block after the other."""
    names = np.unique(blocks[weights > 0])
    if len(names) < _LEAST_BLOCKS:
        return np.full(rows.columns.shape[1], math.inf)
    each = np.repeat(blocks, len(rows.size))
    matrices, sides = [], []
    for name in names:
        part = _Rows(rows.error[each == name], rows.columns[each == name], rows.size)
        matrix, side = part.normal(weights[blocks == name])
        matrices.append(matrix)
        sides.append(side)
    solutions = _solved(np.sum(matrices, axis=0) - matrices, np.sum(sides, axis=0) - sides)
    spread = np.square(solutions - solutions.mean(axis=0)).sum(axis=0)
    return np.asarray(np.sqrt(spread * (len(names) - 1) / len(names)))


def _block_of(places: Places, material: Material) -> Indices:
    """Return the number of the block of the map that every pixel lies in; frames share them."""
    grid = material.grid
    return np.asarray((places.y * _BLOCKS // grid.rows) * _BLOCKS + places.x * _BLOCKS // grid.columns)

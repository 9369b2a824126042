"""Pose corrections of all images: block shifts, normal equations without depth and motion, and added uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.acquisition import PosePriors
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.photo_consistency import SUMS, add_shifts
from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.threads import in_threads

__all__ = [
    "BLOCK_PX",
    "Blocks",
    "CorrectionUncertainty",
    "Elimination",
    "Equations",
    "PointDerivatives",
    "PoseCorrections",
    "ShiftObservations",
    "compute_point_derivatives",
    "count_frames",
    "follow_points",
    "join_blocks",
    "select_blocks",
    "solve_with_prior",
]


CORRECTIONS = 4
"""Number of corrections of an image: along x and y in px, roll in rad, relative scale."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointDerivatives:
    """Derivatives of the image positions of points, x and y in px."""

    by_point: Array
    """By d, q_X, q_Y, q_Z and the column and row of the point, optionally by the acceleration along X and Y; shape
    (points, n, 2, 6 or 8)."""
    by_image: Array
    """By the corrections of the image itself, shape (points, n, 2, 4)."""


def compute_point_derivatives(
    view: ImageView, fields: Array, at: Array, *, accelerated: bool = False, still: bool = False
) -> PointDerivatives:
    """Return the derivatives of the image positions of points: fields (4, points) at column and row (2, points).

    ``still``: Whether motion is zero by definition, whatever the times of the positions, as in a single frame.
    """
    d, q_x, q_y, q_z = fields[:, :, None]
    s, s_y, t = view.s[None], view.s_y[None], view.t[None]
    scale = 1.0 / (1.0 + t * d * q_z / view.focal)
    x = (at[0][:, None] - view.centre_x + d * (t * q_x - s)) * scale
    y = (at[1][:, None] - view.centre_y + d * (t * q_y - s_y)) * scale
    nil, one = np.zeros_like(x), np.ones_like(x)
    shrink = t / view.focal
    right = [scale * (t * q_x - s - x * shrink * q_z), scale * d * t, nil, -scale * d * shrink * x, one, nil]
    down = [scale * (t * q_y - s_y - y * shrink * q_z), nil, scale * d * t, -scale * d * shrink * y, nil, one]
    if accelerated:
        later = 0.5 * scale * d * t**2
        right, down = [*right, later, nil], [*down, nil, later]
    by_point = np.stack([np.stack(np.broadcast_arrays(*each), axis=-1) for each in (right, down)], axis=2)
    if still:
        by_point[..., 1:4] = 0.0
    by_image = np.stack([np.stack([one, nil, -y, x], axis=-1), np.stack([nil, one, x, y], axis=-1)], axis=2)
    return PointDerivatives(by_point, by_image)


def count_frames(view: ImageView) -> int:
    """Return the number of images of every position."""
    return len(view.t) // len(np.unique(np.stack([view.s, view.s_y]), axis=1).T)


def follow_points(moves: PointDerivatives, texture: Array | None = None) -> Array:
    """Return the changes of the parameters of points by displacements of their images, shape (points, 6 or 8, 2 n).

    ``texture``: Structure tensor of the texture at each point, shape (points, 2, 2); by default isotropic.
    """
    by_point = moves.by_point
    root = None
    if texture is not None:
        values, vectors = np.linalg.eigh(texture)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ vectors.swapaxes(1, 2)
        by_point = np.matmul(root[:, None], by_point)
    by_point = by_point.reshape(len(by_point), -1, by_point.shape[-1])
    size = np.linalg.norm(by_point, axis=1) + 1e-300
    follow = np.asarray(np.linalg.pinv(by_point / size[:, None], rcond=1e-4) / size[:, :, None])
    if root is None:
        return follow
    pairs = follow.reshape(*follow.shape[:2], -1, 2)
    return np.asarray(np.matmul(pairs, root[:, None]).reshape(follow.shape))


BLOCK_PX = 8
"""Side length of a block: smaller than the rows of a band beyond its core."""


@dataclass(frozen=True, eq=False)
class ShiftObservations:
    """Normal equations of the shifts between every image and the mean image, in blocks of pixels."""

    sums: NDArray[np.float64]
    """Sums of `add_shifts`, shape (rows of blocks, columns of blocks, n, 7)."""

    @classmethod
    def blank(cls, shape: tuple[int, int], count: int) -> ShiftObservations:
        """Return sums of zero."""
        height, width = shape
        return cls(np.zeros((-(-height // BLOCK_PX), -(-width // BLOCK_PX), count, SUMS)))

    def add(
        self, warped: NDArray[np.float32], gradient: NDArray[np.float32], least: int, first: int, rows: tuple[int, int]
    ) -> None:
        """Add the images of one channel for the blocks that begin in a range of rows."""
        top, bottom = (-(-row // BLOCK_PX) for row in rows)
        add = partial(add_shifts, warped, gradient, least, first, BLOCK_PX, self.sums)
        in_threads(add, [(row, row + 1) for row in range(top, bottom)])

    def centres(self) -> NDArray[np.intp]:
        """Return row and column of the centre of every block, shape (2, rows of blocks, columns of blocks)."""
        down, across = self.sums.shape[:2]
        return np.stack(np.meshgrid(*(np.arange(n) * BLOCK_PX + BLOCK_PX // 2 for n in (down, across)), indexing="ij"))


_STEP_PX = 24  # distance in px of the points at which the effect is computed; it is interpolated linearly


@dataclass(frozen=True, eq=False)
class CorrectionUncertainty:
    """Variances due to the uncertainty of the corrections."""

    variance: Array
    """Variances of d, q_X, q_Y and q_Z at every pixel, shape (4, y, x)."""


def compute_correction_uncertainty(view: ImageView, fields: Array, rooted: Array) -> CorrectionUncertainty:
    """Return the variances of the fit at every pixel due to the uncertainty of the corrections.

    A point with isotropic texture follows the corrections c by K c, with K = (Aᵀ A)⁻¹ Aᵀ E and the derivatives A and E
    of its image positions by its own parameters and by the corrections.

    ``fields``: d, q_X, q_Y and q_Z of every pixel, finite, shape (4, y, x).
    ``rooted``: L of the covariance L Lᵀ of the corrections, shape (4 n, any).
    """
    from scipy.ndimage import map_coordinates

    height, width = fields.shape[1:]
    rows, columns = (np.linspace(0, size - 1, max(2, size // _STEP_PX)).round().astype(int) for size in (height, width))
    down, across = np.meshgrid(rows, columns, indexing="ij")
    at = np.stack([across.ravel(), down.ravel()]).astype(np.float64)
    own = fields[:, down.ravel(), across.ravel()]
    moves = compute_point_derivatives(view, own, at, still=count_frames(view) == 1)
    points = len(at[0])
    follow = follow_points(moves)
    varied = np.empty((4, points))
    pairs = rooted.reshape(-1, 4, rooted.shape[-1])
    for n in range(points):
        moved = np.einsum("nki,niu->nku", moves.by_image[n], pairs, optimize=True).reshape(-1, rooted.shape[-1])
        varied[:, n] = np.square(follow[n, :4] @ moved).sum(axis=-1)
    # The effect on the velocity is proportional to 1 / d.
    varied[1:] *= own[0] ** 2
    y, x = np.mgrid[:height, :width]
    places = np.stack([np.interp(y, rows, np.arange(len(rows))), np.interp(x, columns, np.arange(len(columns)))])
    maps = [map_coordinates(each.reshape(down.shape), places, order=1, mode="nearest") for each in varied]
    variance = np.stack(maps)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance[1:] /= fields[0] ** 2
    return CorrectionUncertainty(variance)


_LEAST_SHARE = 0.5  # smallest fraction of the pixels of a block that are valid in the mean image
_LEAST_ENERGY = 1e-9  # smallest squared gradient of a block relative to the largest one
# Undetermined directions of blocks: eigenvalues below this fraction of those of single parameters.
_SINGULAR_SHARE = 1e-7
_ACCELERATED = 5  # smallest number of frames that separate acceleration from velocity
_PIECE, _MOST_BLOCKS = 256, 6000  # number of blocks processed together, and approximate number of blocks used


@dataclass(frozen=True, eq=False)
class Blocks:
    """Observations of blocks of pixels."""

    weight: Array
    """Σ ∇T ∇Tᵀ of every image, shape (blocks, n, 2, 2)."""
    shift: Array
    """Σ ∇T (T - g), shape (blocks, n, 2)."""
    fields: Array
    """d, q_X, q_Y and q_Z, shape (4, blocks)."""
    at: Array
    """Column and row of their centres, shape (2, blocks)."""
    noise: float
    """Standard deviation of the image residuals relative to the mean image in blocks that fit well."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the corrections c of n images, image by image: matrix · c = side."""

    matrix: Array
    """Shape (4 n, 4 n)."""
    side: Array
    """Shape (4 n,)."""


def select_blocks(shifts: ShiftObservations, fields: Array) -> Blocks:
    """Return the observations of blocks with texture, with the finite fields of every pixel, shape (4, y, x)."""
    rows, columns = shifts.centres()
    height, width = fields.shape[1:]
    rows, columns = np.minimum(rows, height - 1), np.minimum(columns, width - 1)
    counts = shifts.sums[..., 6].mean(axis=-1)
    entries = counts > _LEAST_SHARE * counts.max()
    # Splines of images without noise leave gradients of 1e-150 far from any texture.
    energy = shifts.sums[..., 0].sum(axis=-1) + shifts.sums[..., 2].sum(axis=-1)
    entries &= energy >= _LEAST_ENERGY * energy.max()
    apart = math.isqrt(entries.size // _MOST_BLOCKS) + 1
    some = np.zeros_like(entries)
    some[::apart, ::apart] = True
    entries &= some
    sums = shifts.sums[entries]
    left = np.sqrt(sums[..., 5].sum(axis=-1) / np.maximum(sums[..., 6].sum(axis=-1), 1.0))
    images = max(sums.shape[1] - 1, 1)
    noise = float(np.quantile(left, 0.25)) * np.sqrt(sums.shape[1] / images) if left.size else float("nan")
    return Blocks(
        sums[..., [0, 1, 1, 2]].reshape(*sums.shape[:2], 2, 2),
        sums[..., 3:5],
        fields[:, rows[entries], columns[entries]],
        np.stack([columns[entries], rows[entries]]).astype(np.float64),
        noise,
    )


def join_blocks(regions: Sequence[tuple[Blocks, ImageStack]]) -> Blocks:
    """Return the blocks of several regions, at the places of the whole image."""
    parts = [blocks for blocks, _ in regions]
    counts = [len(blocks.shift) for blocks in parts]
    noise = math.sqrt(float(np.average([blocks.noise**2 for blocks in parts], weights=counts)))
    at = [blocks.at + np.array(images.corner, dtype=np.float64)[:, None] for blocks, images in regions]
    weight, shift = (np.concatenate([getattr(each, name) for each in parts]) for name in ("weight", "shift"))
    return Blocks(weight, shift, np.concatenate([each.fields for each in parts], axis=1), np.concatenate(at, 1), noise)


class Elimination:
    """Reduced normal equations of the corrections, with the depth and motion of every block eliminated."""

    def __init__(self, blocks: Blocks, view: ImageView) -> None:
        self._noise = blocks.noise
        self._size = CORRECTIONS * len(view.s)
        frames = count_frames(view)
        accelerated, still = frames >= _ACCELERATED, frames == 1
        self._parts = [
            _compute_part(blocks, view, slice(first, first + _PIECE), accelerated=accelerated, still=still)
            for first in range(0, len(blocks.shift), _PIECE)
        ]

    def equations(self, weight: Array) -> Equations:
        """Return the equations of all blocks, with weights of shape (blocks,)."""
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
        """Return the residual of the block shifts after corrections (n, 4), with depth and motion adjusted.

        Returns: In squares of the image noise per degree of freedom, shape (blocks,).
        """
        c = corrections.ravel()
        found = []
        for part in self._parts:
            # |shift - c|² in the norm of all unknowns, minus the part explained by the parameters of the blocks.
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
    """Products of a group of p blocks."""

    own: Array
    """Σ Eᵀ W E of every image with the derivatives E by its corrections, shape (p, n, 4, 4)."""
    mixed: Array
    """Products of the decorrelated block parameters with all corrections, shape (p, m, 4 n)."""
    plain: Array
    """Σ Eᵀ W δ, shape (p, 4 n)."""
    own_shift: Array
    """Products of the block parameters with the shifts, shape (p, m)."""
    square: Array
    """Σ δᵀ W δ, shape (p,)."""
    free: Array
    """Number of shifts minus that of the block parameters, at least 1, shape (p,)."""

    @property
    def side(self) -> Array:
        """Right-hand side of the equations of the corrections, shape (p, 4 n)."""
        return np.asarray(self.plain - np.einsum("pms,pm->ps", self.mixed, self.own_shift, optimize=True))


def _compute_part(blocks: Blocks, view: ImageView, part: slice, *, accelerated: bool, still: bool) -> _Part:
    moves = compute_point_derivatives(
        view, blocks.fields[:, part], blocks.at[:, part], accelerated=accelerated, still=still
    )
    weight, shift = blocks.weight[part], blocks.shift[part]
    a, e = moves.by_point, moves.by_image
    count = len(weight)
    weighted = np.matmul(weight, a)
    matrix = np.matmul(a.reshape(count, -1, a.shape[-1]).swapaxes(1, 2), weighted.reshape(count, -1, a.shape[-1]))
    size = np.sqrt(np.maximum(np.einsum("pii->pi", matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / (size[:, :, None] * size[:, None]))
    entries = values > _SINGULAR_SHARE
    apart = (
        vectors * np.where(entries, 1.0 / np.sqrt(np.maximum(values, _SINGULAR_SHARE)), 0.0)[:, None] / size[:, :, None]
    )
    by_image = np.matmul(weight, e)
    mixed = np.einsum("pnki,pnkj->pinj", a, by_image, optimize=True).reshape(count, a.shape[-1], -1)
    square, shifts = _squares(weight, shift)
    return _Part(
        np.matmul(e.swapaxes(-1, -2), by_image),
        np.matmul(apart.swapaxes(1, 2), mixed),
        np.einsum("pnki,pnk->pni", e, shift, optimize=True).reshape(count, -1),
        np.einsum("pim,pnki,pnk->pm", apart, a, shift, optimize=True),
        square,
        np.maximum(shifts - entries.sum(axis=1), 1).astype(np.float64),
    )


def _squares(weight: Array, shift: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return Σ bᵀ W⁻¹ b of every block, and the number of observed shifts: per image two, or one along a gradient."""
    a, b, c = weight[..., 0, 0], weight[..., 0, 1], weight[..., 1, 1]
    half, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    largest = half + spread
    determinant = a * c - b * b
    both = determinant > 1e-3 * largest**2
    x, y = shift[..., 0], shift[..., 1]
    whole = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(both, determinant, 1.0)
    # Along the gradient alone, b is parallel to it, except for rounding.
    some = largest > 0
    along = (x * x + y * y) / np.where(some, largest, 1.0)
    square = np.where(both, whole, np.where(some, along, 0.0)).sum(axis=1)
    return square, (2 * both + (some & ~both)).sum(axis=1)


_LARGEST_INFORMATION = 1e12  # of observations relative to the prior: images without noise would leave no digits for it


def solve_with_prior(matrix: Array, side: Array, unknown: Array) -> tuple[Array, Array]:
    """Return the covariance of unknowns with a prior of mean 0 and variance 1, and their step from current values.

    Combinations that the observations determine to rounding only keep the prior.

    ``matrix``, ``side``: Normal equations of the observations at the current values. ``unknown``: Current values.
    """
    values, vectors = np.linalg.eigh(matrix)
    determined = values > len(values) * np.finfo(np.float64).eps * np.abs(values).max()
    information = np.where(determined, np.minimum(values, _LARGEST_INFORMATION), 0.0)
    gain = vectors / (1.0 + information)
    # Where information is limited, the step is that of the observations.
    reduced = np.where(determined, vectors.T @ side * information / np.where(determined, values, 1.0), 0.0)
    return gain @ vectors.T, gain @ (reduced - vectors.T @ unknown)


# Blocks with a residual above this multiple of the median are excluded: they do not move as a point.
_OUTLIER = 4.0
_PASSES = 3
_STILL = 0.1
_KINDS = (0, 0, 1, 2)  # shifts along x and y, roll, scale


class PoseCorrections:
    """Corrections of all images and their covariance.

    The error of an image is the sum of that of its position, common to all visits, and that of the single visit. The
    image of the reference position in the estimated frame has no error by definition; all others are relative to it.
    """

    def __init__(self, priors: PosePriors, images: ImageStack) -> None:
        view = images.view()
        count, cameras = len(view.s), len(images.positions)
        fixed, fresh = priors.position, priors.visit
        self._turned_px = fixed[:2]
        # Unknowns are the errors of positions, then those of single visits, each in units of its standard deviation.
        parts = np.zeros((count, CORRECTIONS, cameras * len(fixed) + count * len(fresh)))
        for n in range(count):
            for k, std in enumerate(fixed):
                parts[n, k, (n % cameras) * len(fixed) + k] = std
            for k, std in enumerate(fresh):
                parts[n, k, cameras * len(fixed) + n * len(fresh) + k] = std
        reference = np.flatnonzero((view.s == 0) & (view.s_y == 0) & (view.t == 0))
        if reference.size:
            parts = parts - parts[reference[0]]
        entries = np.abs(parts).max(axis=(0, 1)) > 0
        self._parts = parts[..., entries].reshape(count * CORRECTIONS, -1)
        kinds = np.concatenate([np.tile(_KINDS, cameras), np.full(count * len(fresh), _KINDS[-1] + 1)])
        self._kinds: NDArray[np.intp] = kinds[entries].astype(np.intp)
        self._times = np.repeat(images.times, cameras)
        self._unknown = np.zeros(self._parts.shape[1])
        self._covariance: Array = np.eye(len(self._unknown))

    @property
    def parts(self) -> Array:
        """Errors of all images by the unknowns, each in units of its prior, shape (4 n, unknowns)."""
        return self._parts

    @property
    def kinds(self) -> NDArray[np.intp]:
        """Group of each unknown: shifts of positions, rolls, scales, shifts of single visits; shape (unknowns,)."""
        return self._kinds

    @property
    def values(self) -> Array:
        """Corrections in the order of `ImageStack.stack`, shape (n, 4): along x and y in px, roll in rad, scale."""
        return np.asarray((self._parts @ self._unknown).reshape(-1, CORRECTIONS))

    @property
    def std(self) -> Array:
        """Standard deviations of `values`."""
        variance = np.einsum("cu,uv,cv->c", self._parts, self._covariance, self._parts, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, CORRECTIONS))

    def update(self, shifts: ShiftObservations, fields: Array, images: ImageStack) -> float:
        """Update the corrections from block observations, and return the largest displacement of an image in px.

        Changes within a tenth of the standard deviation are ignored. ``fields``: d and q for warping, shape (4, y, x).
        """
        blocks = select_blocks(shifts, fields)
        if not len(blocks.shift) or not blocks.noise > 0:
            return 0.0
        return self.update_by_blocks(join_blocks([(blocks, images)]), images)

    def update_by_blocks(self, blocks: Blocks, images: ImageStack) -> float:
        """Update the corrections as `update` from blocks at their places in the whole image."""
        view = images.whole_view()
        taken = np.repeat(np.isin(self._times, images.times), CORRECTIONS)
        parts, before = self._parts[taken], self.values
        elimination = Elimination(blocks, view)
        kept: Array = np.ones(len(blocks.shift))
        excess = 1.0
        unknown: Array = self._unknown
        for _ in range(_PASSES):
            entries = elimination.equations(kept)
            noise = excess * (blocks.noise / images.transfer) ** 2
            matrix = parts.T @ entries.matrix @ parts / noise
            covariance, step = solve_with_prior(matrix, parts.T @ entries.side / noise, self._unknown)
            unknown = self._unknown + step
            left = elimination.misfit((parts @ step).reshape(-1, CORRECTIONS))
            usual = float(np.median(left))
            kept = (left < _OUTLIER * usual).astype(np.float64)
            # Where the residuals of blocks exceed the noise, the errors of their shifts are larger.
            excess = max(1.0, float(left[kept > 0].mean())) if kept.any() else 1.0
            self._covariance = covariance
        self._unknown = unknown
        change = np.abs(self.values - before)
        arm = max(images.whole_shape) / 2
        moved = np.where(change > _STILL * self.std, change, 0.0) * np.array([1.0, 1.0, arm, arm])
        return float(moved.max())

    @property
    def rooted(self) -> Array:
        """L of the covariance L Lᵀ of the corrections, shape (4 n, unknowns)."""
        return np.asarray(self._parts @ np.linalg.cholesky(self._covariance))

    @property
    def turned_px(self) -> tuple[float, float]:
        """Standard deviations of the shifts of positions along x and y, which may be rotations, in px."""
        return self._turned_px

    def effect(self, images: ImageStack, fields: Array) -> CorrectionUncertainty:
        """Return the effect of the uncertainty of the corrections on disparity and velocity, shape (4, y, x)."""
        return compute_correction_uncertainty(images.view(), fields, self.rooted)
